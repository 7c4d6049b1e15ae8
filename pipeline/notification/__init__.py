"""Delivery of changes of state to people: the outbox, and the receivers.

Imports `config`, `schema`, `store` and what lies below.
"""

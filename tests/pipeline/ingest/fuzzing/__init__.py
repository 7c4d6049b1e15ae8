"""Fuzzing of the three readers: small valid logs, damage done to them, and what came of each.

Every read happens in a process of its own, as native code that crashes takes its process with it.
"""

"""A motor's nights as records of numbers, from the tables, and people's decisions on them."""

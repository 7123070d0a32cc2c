"""Random campaigns: hostile input and faults, drawn from a seed, for as long as asked (docs/testing.md).

The same functions serve the tests, with few trials, and ``python -m fuzz``, which ``make fuzz`` calls.
"""

"""How many columns each logged quantity of a result has."""

WIDTHS = {
    "feature_error": 8,
    "depth": 4,
    "position": 3,
    "quaternion": 4,
    "twist": 6,
    "wrench": 6,
    "fuzzy_output": 6,
    "leg_lengths": 6,
    "leg_forces": 6,
}

"""Scenarios: their blocks and rules, YAML, messages, and the way to the core's settings."""

"""Scenarios: blocks and rules, YAML, messages, the core's settings."""

"""Scenarios in other tools."""

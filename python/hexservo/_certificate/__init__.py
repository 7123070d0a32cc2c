"""Certificates of runs."""

"""Campaigns: drawn variations, judged against requirements."""

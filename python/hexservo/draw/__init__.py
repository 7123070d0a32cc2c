"""Figures: of a run, a batch, a comparison, findings, a benchmark."""

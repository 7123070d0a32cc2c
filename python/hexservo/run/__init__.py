"""Runs: one scenario, batches, controllers, results, metrics, saving, export and comparison."""

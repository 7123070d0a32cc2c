"""Runs: one, batches, controllers, results, metrics, files, comparison."""

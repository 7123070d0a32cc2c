"""Findings about a scenario or a run: the shapes of evidence, and what fills them: analysis, certificate, diagnosis."""

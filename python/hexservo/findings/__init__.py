"""Evidence, and what fills it: analysis, certificate, diagnosis."""

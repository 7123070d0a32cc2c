"""Evidence about scenarios and runs: analysis, certificate, diagnosis."""

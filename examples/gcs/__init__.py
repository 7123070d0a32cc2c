"""Hexapods whose controllers take poses in a text protocol over TCP, as GCS has it (docs/position-machines.md)."""

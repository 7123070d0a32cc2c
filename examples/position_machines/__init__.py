"""What the programs for machines that take positions share (docs/position-machines.md)."""

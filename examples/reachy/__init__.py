"""A desktop robot's head that takes angles of cranks 50 times a second, behind a socket (docs/position-machines.md)."""

"""Face tracking of a robot's head that others built, in MuJoCo: its published law, its open fix, and hexservo."""

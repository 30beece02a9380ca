"""What the program is held against: a rig of other physics, sealed blind checks, and the published figures."""

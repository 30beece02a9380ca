"""What came back from a rig: folders, files and columns."""

"""The blind check: cases sealed, diagnosed, opened and scored."""

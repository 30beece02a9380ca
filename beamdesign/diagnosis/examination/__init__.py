"""Whether data are what they say they are."""

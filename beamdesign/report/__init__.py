"""What is shown to people: plots that take and return matplotlib axes."""

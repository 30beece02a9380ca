"""Design: sections, controller and end mass, from what is asked."""

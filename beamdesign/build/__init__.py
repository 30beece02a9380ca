"""The specification of a prototype: what to build, what of it is proved, and how to accept what was built."""

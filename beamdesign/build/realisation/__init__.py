"""Controllers as machines carry them out: rate, words, C code, and what these cost in margin."""

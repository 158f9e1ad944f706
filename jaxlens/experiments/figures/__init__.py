"""The figures of experiments; deterministic files, colours that the colour-blind can tell apart."""

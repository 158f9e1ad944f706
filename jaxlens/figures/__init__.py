"""What draws, for experiments and the command line: deterministic files, colours that the colour-blind can tell apart."""

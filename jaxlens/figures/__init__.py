"""What draws, for experiments and command line: files that never vary, colours that the colour-blind tell apart."""

"""What draws, for experiments and the command line: deterministic files, colours that colour-blind people can tell."""

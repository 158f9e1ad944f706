"""The kinds of experiment that are built in."""

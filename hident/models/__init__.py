"""What is done with a fitted model: its file, and what other programs are told of it."""

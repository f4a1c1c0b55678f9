"""The command line: one program, `selfscan`, whose subcommands live beside the work they start."""

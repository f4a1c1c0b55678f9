"""Settings, command lines, progress, signals and errors of every command."""

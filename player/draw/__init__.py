"""A posed mesh drawn: passes, their plan, their resources."""

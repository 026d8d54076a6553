"""A node as a process: its command line, its start, its executor and its end."""

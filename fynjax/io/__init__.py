"""Files in and out. Each sub-package reads and writes one kind of file."""

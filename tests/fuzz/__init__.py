"""Damaged files for every reader: each must end in one clear error, or be read as what it is.

`python -m tests.fuzz --minutes 60` tries as many as it can, and saves those that broke a reader.
"""

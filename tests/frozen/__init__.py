"""What every command writes for a tiny input, as committed numbers: `python -m tests.frozen.write`
writes them anew after a change that is meant."""

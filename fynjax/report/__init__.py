"""What a person looks at after a run: figures and pages, nothing else."""

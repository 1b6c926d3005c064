"""The paper's own matching, rejection and clustering (section II-B): what method `paper` needs, and nothing else."""

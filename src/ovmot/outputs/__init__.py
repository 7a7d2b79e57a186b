"""Everything that a run writes: tables, the overlay video, and `run.json`."""

"""Many runs: sequences x settings x seeds, on this machine or a Dask cluster."""

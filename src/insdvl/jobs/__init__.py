"""Long computations: many independent tasks, on the cores of this machine or on a Dask cluster.

`options` has the command line options that choose the workers, `pool` computes tasks on them,
`store` keeps the results on disk. `backends` and `cluster` know joblib and Dask, `progress` the
line on the terminal.
"""

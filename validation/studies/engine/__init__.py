"""The engine of all studies: workers run `Case`s, and a `Store` keeps their results.

- `case`: `Case`, the definition of one closed loop; its experiment, its run, its figures of merit.
- `sources`: the files of a robot or a controller, here or on another machine.
- `fingerprint`: one hash of everything on which a run depends.
- `worker`: `CaseJob` → `CaseResult`, in any process on any machine.
- `executors`: jobs on the processes of this machine, or on a dask cluster (`cluster`).
- `ensemble`: the same loop from starts that differ by 1e-9; `distribution`: its figures.
- `store`: one complete file per case; the missing cases of a folder.
"""

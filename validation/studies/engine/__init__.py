"""The one engine of all studies: a `Case` is run by a worker, and a `Store` keeps what came out.

- `case`: `Case`, all that defines one closed loop; its experiment, its run, its figures of merit.
- `sources`: the files of a robot or a controller, here or on another machine.
- `fingerprint`: what a run depends on, as one hash.
- `worker`: `CaseJob` → `CaseResult`, in whichever process and on whichever machine.
- `executors`: jobs on the processes of this machine, or on a dask cluster (`cluster`).
- `ensemble`: the same loop from starts that differ by 1e-9; `distribution`: what came of it.
- `store`: a file a case, whole or not at all; what is missing below a folder.
"""

"""Conformance of a user's own class: does it meet its contract?

    from softdyn import load, testing

    report = testing.check_controller(MyLaw, load("finger"), period=0.005)
    print(report)                      # a line for each check; what fails names the call
    assert report.passed

Each function takes a class, which is built as ``CLASS(model)``, a function that builds one from a
model, or an object, of which it uses copies. A force is built without a model, as ``CLASS()``.

- `report`: `RuleResult`, `Conformance`, and how a class is built and its errors become lines;
- `samples`: states, references and readings for the calls;
- `controllers`: `check_controller`;
- `observers`: `check_observer`;
- `functions`: `check_task`, `check_barrier`, `check_reference`, against central differences;
- `forces`: `check_force`;
- `rigs`: `check_plant`, `check_driver`;
- `kinds`: the kind of a class, by the methods that it has; `check` for any kind.

The public names are imported when they are used, as `__init__.pyi` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

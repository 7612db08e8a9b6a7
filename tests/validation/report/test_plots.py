"""The figures: present, complete, as wide as a page's column, and reproducible byte by byte."""

import struct
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softdyn.validation.loop.pictures import plot_style, time_figures
from softdyn.validation.loop.pictures.time_figures import thin
from softdyn.validation.report import figures, plot_data, plots
from softdyn.validation.report.plot_data import PlottedRun, lyapunov_band, thin_path
from softdyn.validation.studies import benchmark
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.sources import load_model
from tests.support import logs
from tests.support.refused import refused

NU = {"finger": 2, "helix": 9, "spirob": 3}
SIX = ("clf-qp", "soft-id-clf-qp", "id-clf-qp", "ic", "uic", "ic-qp")
ALL = {
    "lyapunov_set_points", "lyapunov_trajectories", "convergence_finger", "tracking",
    "error_set_points", "error_trajectories", "inputs",
}  # fmt: skip


def make_log(case, *, end=1.0, steps=120, failed=False, V=True):
    """A log of a plausible run: a decaying spiral, cut off at a part of its duration."""
    duration = 10.0 if case.kind == "set_point" else 4 / case.value
    n, nu = max(int(steps * end), 0), NU.get(case.robot, 2)
    t = duration / steps * np.arange(n + 1)
    s = t / duration
    seed = len(case.controller) + 3 * case.value
    decay = 0.1 * np.exp(-5 * s) + 1e-4
    error = decay[:, None] * np.column_stack((np.cos(30 * s + seed), 0 * s, np.sin(30 * s)))
    turn = 4 * np.pi * s if case.kind == "tracking" else 0 * s
    y_ref = np.column_stack((0.1 + 0.08 * np.cos(turn), 0 * s, 0.03 * np.sin(turn) - 0.2))
    u = np.sin(np.outer(20 * s[:n], 1 + np.arange(nu)))
    return logs.make_log(
        t, error, y=y_ref + error, y_ref=y_ref, u=u,
        V=50 * decay[:n] ** 2 if V else np.full(n, np.nan), delta=np.zeros(n),
        step_us=np.full(n, np.nan), u_min=-np.ones(nu), u_max=np.ones(nu), u_unit="0.1 N m",
        robot=case.robot, controller=case.controller, kind=case.kind,
        theta=case.value if case.kind == "set_point" else None,
        omega=case.value if case.kind == "tracking" else None,
        duration=duration, period=duration / steps, timestep=duration / steps, length=0.24,
        complete=end == 1.0, failed=failed or end < 1.0,
        reason="it diverged" if failed or end < 1.0 else None,
    )  # fmt: skip


def write(folder, cases, **options):
    for case in cases:
        path = benchmark.store(folder).log_path(case.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        make_log(case, **options).save(path)


def names(paths):
    found = {Path(path).stem for path in paths}
    assert {Path(path).name for path in paths} == {
        f"{n}.{k}" for n in found for k in ("pdf", "png")
    }
    return found


def size(png):
    """Width and height (px) of a PNG file."""
    data = Path(png).read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    return struct.unpack(">II", data[16:24])


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """A grid of two robots, six controllers and a user's, some runs of which failed."""
    folder = tmp_path_factory.mktemp("full")
    cases = benchmark.grid(("finger", "spirob"), (*SIX, "my/own.py:Push"), (0, 0.5), (0.2, 0.5))
    write(folder, cases)
    for case, options in {
        Case("finger", "uic", "tracking", 0.2): {"end": 0.3},
        Case("spirob", "soft-id-clf-qp", "set_point", 0.5): {"end": 0.6},
        Case("spirob", "soft-id-clf-qp", "tracking", 0.2): {"end": 0.8},
        Case("finger", "clf-qp", "set_point", 0.0): {"end": 0.0},
        Case("spirob", "ic", "tracking", 0.5): {"failed": True},
    }.items():
        write(folder, [case], **options)
    return folder, cases, plots.make_all(cases, folder)


def test_a_full_grid_has_every_figure(full):
    folder, _, files = full
    assert names(files) == ALL | {"convergence_spirob"}
    assert {file.parent for file in files} == {folder / "figures"}
    for file in files:
        assert file.stat().st_size > 5000
        if file.suffix == ".pdf":
            data = file.read_bytes()
            assert data.startswith(b"%PDF-")
            assert data.rstrip().endswith(b"%%EOF")
            assert b"CreationDate" not in data


def test_figures_fit_the_columns_of_a_page(full):
    widths = {file.stem: size(file)[0] for file in full[2] if file.suffix == ".png"}
    one, both = (int(plot_style.PNG_DPI * w) for w in (plot_style.COLUMN, plot_style.PAGE))
    assert widths["lyapunov_set_points"] == widths["lyapunov_trajectories"] == one
    assert widths["inputs"] == both
    assert set(widths.values()) <= {one, both, int(plot_style.PNG_DPI * 2 * 2.387),
                                    int(plot_style.PNG_DPI * (2 * 1.7 + 0.36))}  # fmt: skip


def test_the_same_bytes_every_time(full, tmp_path):
    folder, cases, files = full
    first = {file.name: file.read_bytes() for file in files}
    with plot_style.style():
        store = benchmark.store(folder)
        runs = [PlottedRun.load(case, store.log_path(case.name)) for case in cases]
        again = plot_style.save(
            figures.lyapunov(runs, "set_point"), tmp_path / "lyapunov_set_points"
        )
    assert {file.name: file.read_bytes() for file in again}.items() <= first.items()


def test_the_users_own_settings_do_not_matter(full, tmp_path):
    import matplotlib

    folder, cases, files = full
    runs = [PlottedRun.load(case, benchmark.store(folder).log_path(case.name)) for case in cases]
    with matplotlib.rc_context({"font.size": 30, "lines.linewidth": 9, "savefig.dpi": 30}):
        before = dict(matplotlib.rcParams)
        with plot_style.style():
            again = plot_style.save(figures.tracking(runs), tmp_path / "tracking")
        assert dict(matplotlib.rcParams) == before
    first = {file.name: file.read_bytes() for file in files}
    assert {file.name: file.read_bytes() for file in again}.items() <= first.items()


def test_no_global_state_of_pyplot():
    modules = (plots, figures, time_figures, plot_style, plot_data)
    assert not any("pyplot" in Path(module.__file__).read_text() for module in modules)


@pytest.mark.parametrize(
    ("controllers", "thetas", "omegas", "options", "expected"),
    [
        (("own.py:Push",), (0.5,), (0.3,), {"V": False}, ALL - {
            "lyapunov_set_points", "lyapunov_trajectories"}),
        (("ic",), (1.0,), (), {}, {
            "lyapunov_set_points", "convergence_finger", "error_set_points", "inputs"}),
        (("ic",), (1.0,), (), {"end": 0.0}, {"convergence_finger", "error_set_points"}),
    ],
)  # fmt: skip
def test_partial_grids_have_fewer_figures(tmp_path, controllers, thetas, omegas, options, expected):
    cases = benchmark.grid(("finger",), controllers, thetas, omegas)
    write(tmp_path, cases, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.simplefilter("ignore", DeprecationWarning)  # matplotlib 3.9 of a newer pyparsing
        assert names(plots.make_all(cases, tmp_path)) == expected


def test_names_that_would_be_mathematics(tmp_path):
    (tmp_path / "_arm$x$.urdf").write_text(Path(load_model("finger").robot.path).read_text())
    robot = str(tmp_path / "_arm$x$.urdf")
    cases = benchmark.grid((robot,), ("_a$b_c.py:^{D", "ic"), (), (0.2,))
    write(tmp_path, cases)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.simplefilter("ignore", DeprecationWarning)  # matplotlib 3.9 of a newer pyparsing
        assert len(plots.make_all(cases, tmp_path)) == 8


# --- the command ----------------------------------------------------------------------------------


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    from softdyn.commands import benchmark as script
    from softdyn.commands import cli

    monkeypatch.setattr(cli, "one_thread", lambda: None)
    monkeypatch.setattr(warnings, "formatwarning", warnings.formatwarning)

    def call(*arguments):
        grid = ["--robots", "finger", "--controllers", "ic", "--thetas", "--omegas", "0.2"]
        code = script.main([*grid, *arguments, "--out", "out", "--plots"])
        return code, *capsys.readouterr()

    return call


def test_plots_alone_run_nothing_and_figures_of_an_earlier_grid_go(call):
    (case,) = benchmark.grid(("finger",), ("ic",), (), (0.2,))
    write(Path("out"), [case])
    folder = Path("out/figures")
    folder.mkdir()
    for name in ("convergence_helix.pdf", "lyapunov_set_points.png", "mine.png"):
        (folder / name).write_text("old")
    code, text, errors = call()
    assert (code, errors) == (0, "")
    assert {*folder.iterdir()} == {*map(Path, text.split()), folder / "mine.png"}
    assert names(text.split()) == {
        "lyapunov_trajectories", "tracking", "error_trajectories", "inputs",
    }  # fmt: skip
    assert {path.name for path in Path("out").iterdir()} == {"runs", "figures"}


def test_plots_name_the_logs_that_are_missing(call):
    code, text, errors = call("--omegas", "0.2", "0.5")
    assert (code, text) == (2, "")
    assert errors == (
        "error: out: expected the logs of all 2 runs, "
        "got no log of finger/ic/tracking_0.2, finger/ic/tracking_0.5\n"
    )
    assert not Path("out").exists()


def test_of_many_missing_logs_three_are_named_and_the_others_counted(call):
    _, _, errors = call("--omegas", "0.1", "0.2", "0.3", "0.4", "0.5")
    assert errors.endswith("/tracking_0.1, finger/ic/tracking_0.2, finger/ic/tracking_0.3 "
                           "and 2 more\n")  # fmt: skip
    _, _, errors = call("--omegas", "0.1", "0.2", "0.3")
    assert errors.endswith("finger/ic/tracking_0.3\n")


def test_plots_of_a_damaged_log(call):
    path = benchmark.store(Path("out")).log_path(Case("finger", "ic", "tracking", 0.2).name)
    path.parent.mkdir(parents=True)
    path.write_bytes(b"PK nothing")
    code, text, errors = call()
    assert (code, text) == (2, "")
    assert errors.startswith(f"error: {path}: expected a log")
    assert errors.count("\n") == 1


# --- the data ---------------------------------------------------------------------------------


def test_thinning_keeps_peaks():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 100_000))
    x[54321], y[777] = 50.0, -60.0
    kept = thin(x, y, bins=100)
    assert (np.diff(kept) > 0).all()
    assert len(kept) <= 402
    assert {0, 777, 54321, len(x) - 1} <= {*kept}
    for begin in range(0, 100_000, 1000):
        part = kept[(kept >= begin) & (kept < begin + 1000)]
        for column in (x, y):
            assert column[part].max() == column[begin : begin + 1000].max()
            assert column[part].min() == column[begin : begin + 1000].min()


def test_thinning_leaves_short_logs_alone():
    assert (thin(np.arange(50.0)) == np.arange(50)).all()


def test_a_thinned_path_stays_within_its_tolerance():
    s = np.linspace(0, 40, 20_000)
    path = np.column_stack((np.cos(s) * s, np.sin(s)))
    kept = thin_path(path, 0.05)
    assert kept[0] == 0
    assert kept[-1] == len(s) - 1
    assert len(kept) < len(s) / 2
    before = kept[np.searchsorted(kept, np.arange(len(s)), side="right") - 1]
    assert np.linalg.norm(path - path[before], axis=1).max() <= 0.05


def make_run(tmp_path, **options):
    case = Case("finger", "soft-id-clf-qp", "set_point", 0.5)
    write(tmp_path, [case], **options)
    return PlottedRun.load(case, benchmark.store(tmp_path).log_path(case.name))


def test_a_band_holds_every_sample(tmp_path):
    run = make_run(tmp_path, steps=5000)
    given = run.log.V
    V = given.copy()
    V[2500] *= 1e4  # one sample
    runs = [replace(run, log=run.log.altered(V=V)) for V in (V, 3 * given, given**2)]
    band = lyapunov_band(runs)
    curves = np.array([run.log.V / run.log.V[0] for run in runs])
    assert band.high.max() == curves.max()
    assert band.low.min() == pytest.approx(max(curves.min(), 1e-12))
    assert (band.low <= band.mean * (1 + 1e-9)).all()
    assert (band.mean <= band.high * (1 + 1e-9)).all()
    assert (band.s[0], band.mean[0], band.low[0], band.high[0]) == (0, 1, 1, 1)
    same = lyapunov_band([run, run])
    k = int(np.argmin(abs(same.s - 0.5)))
    assert same.mean[k] == pytest.approx(
        np.interp(0.5, run.log.t[:-1] / 10, given / given[0]), rel=0.03
    )


def test_paths_are_drawn_in_the_plane_of_x_and_z(tmp_path):
    run = make_run(tmp_path)
    y = np.random.default_rng(0).normal(size=run.log.y.shape)
    run = replace(run, log=run.log.altered(y=y, y_ref=2 * y))
    np.testing.assert_allclose(run.path, 100 * np.delete(y, 1, axis=1))
    np.testing.assert_allclose(run.goal, 200 * np.delete(y, 1, axis=1))


def test_a_run_that_ended_early_is_marked_and_counts_as_long_as_it_lasts(tmp_path):
    whole, half = make_run(tmp_path), make_run(tmp_path, end=0.5)
    band = lyapunov_band([whole, half])
    assert band.s[-1] > 0.98
    ((s, value),) = band.ends
    assert s == pytest.approx(0.5, abs=0.02)
    assert value == half.log.V[-1] / half.log.V[0]


def test_samples_that_are_not_finite_are_left_out(tmp_path):
    case = Case("finger", "ic", "tracking", 0.2)
    log = make_log(case, end=0.5)
    error, y = log.error.copy(), log.y.copy()
    error[-1] = y[-1] = np.nan
    path = tmp_path / "x.npz"
    log.altered(error=error, y=y).save(path)
    run = PlottedRun.load(case, path)
    assert len(run.log.t) == len(run.error) == len(log.t) - 1
    assert np.isfinite(run.log.y).all()


def test_runs_without_a_lyapunov_function_have_no_band(tmp_path):
    assert lyapunov_band([make_run(tmp_path, V=False)]) is None
    assert lyapunov_band([]) is None


def test_missing_logs_are_an_error(tmp_path):
    with refused("tracking_0.2.npz", "No such file or directory"):
        plots.make_all([Case("finger", "ic", "tracking", 0.2)], tmp_path)


# --- colours ------------------------------------------------------------------------------------


def test_everyone_has_a_look_of_their_own_that_does_not_depend_on_the_others():
    known = plot_style.CONTROLLERS
    mine = plot_style.looks(["ic", "a.py:A", "b.py:B"], known)
    assert all(mine[name] == known[name] for name in SIX)
    shown = [mine[name] for name in (*SIX, "a.py:A", "b.py:B")]
    assert len(set(shown)) == len(shown)
    assert len({colour for colour, _ in known.values()}) == len(known)
    assert len({dashes for _, dashes in known.values()}) == len(known)
    robots = plot_style.ROBOTS.values()
    assert len({colour for colour, _ in robots}) == len({dashes for _, dashes in robots}) == 4

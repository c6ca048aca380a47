"""Clocks of a bench are matched by what its recordings show of the same presses; nothing is filled in without a word."""

import tomllib

import cv2
import numpy as np
import pytest

from gelforge.commands import align as command
from gelforge.formats.align import Recording, match_clock, without_level
from gelforge.formats.benchfiles import read_gauge, read_path
from gelforge.labelling.sensor import load_sensors
from gelforge.records.image import read_image
from gelforge.records.log import read_log, read_presses
from gelforge.reporting import canvas
from gelforge.stages.poses import Bodies, judge_rows
from tests.support.parameters import parameters
from tests.support.refused import refused

LENGTH = 150.0  # s
STARTS = np.array([8.0, 27.5, 45.0, 70.3, 88.0, 101.7, 125.0])
DEPTHS = np.array([0.5, 1.1, 0.8, 1.4, 0.6, 1.0, 1.2])


def height(times):
    """Height of the tip over the apex, mm, at true times: down at 0.6 mm/s, held for a second, up at 0.9 mm/s, 0.6 mm above between."""
    z = np.full(len(times), 0.6)
    for start, depth in zip(STARTS, DEPTHS, strict=True):
        down = (0.6 + depth) / 0.6
        up = (0.6 + depth) / 0.9
        z = np.minimum(
            z, np.interp(times, start + np.array([0, down, down + 1, down + 1 + up]), [0.6, -depth, -depth, 0.6])
        )
    return z


def force(times):
    """What presses, N, by the law of a sphere."""
    return 3.0 * np.maximum(-height(times), 0.0) ** 1.6


def clock(times, delay, ppm):
    """True times as another clock shows them: true = shown + delay + ppm (shown - LENGTH / 2)."""
    return (times - delay + 1e-6 * ppm * LENGTH / 2) / (1 + 1e-6 * ppm)


def sampled(rate, rng, dropped=0.0, jitter=0.0):
    times = np.arange(0.0, LENGTH, 1.0 / rate) + rng.uniform(0, 1 / rate)
    times = times + rng.uniform(-jitter, jitter, len(times)) / rate
    keep = np.ones(len(times), bool)
    for start in rng.uniform(0, LENGTH, round(dropped * LENGTH)):
        keep &= (times < start) | (times > start + 0.4)
    return times[keep]


BENCHES = {  # rates of gauge, path and images in 1/s, delay in s, drift in ppm, gaps a second, jitter of an interval
    "delayed": (100, 50, 25, 0.3, 0, 0.0, 0.2),
    "drifting": (80, 100, 30, 12.0, 50, 0.0, 0.2),
    "with gaps": (100, 40, 25, -0.3, -50, 0.05, 0.2),
    "slow gauge": (20, 100, 60, -47.0, 50, 0.02, 0.1),
}


@pytest.mark.parametrize("name", ["drifting", "with gaps", "slow gauge"])
def test_clocks_are_right_to_five_milliseconds(name):
    gauge_rate, path_rate, image_rate, delay, ppm, dropped, jitter = BENCHES[name]
    rng = np.random.default_rng(len(name))
    at = sampled(gauge_rate, rng, dropped, jitter)
    gauge = Recording("gauge", at, (force(at) + rng.normal(0, 0.02, len(at)))[:, None])
    on_path, seen = sampled(path_rate, rng, dropped, jitter), sampled(image_rate, rng, dropped, jitter)
    path = Recording("path", clock(on_path, delay, ppm), -np.round(height(on_path), 3)[:, None])
    change = np.maximum(-height(seen), 0.0) ** 0.7 * 20 + rng.normal(0, 0.1, len(seen))
    images = Recording("images", clock(seen, 2 * delay, -ppm), change[:, None])
    probe = np.linspace(STARTS[0], STARTS[-1], 20)
    for other, late, gains in ((path, delay, ppm), (images, 2 * delay, -ppm)):
        found = match_clock(gauge, other, 0.1)
        assert not found.rival
        error = found.to_gauge(clock(probe, late, gains)) - probe
        assert np.abs(error).max() < 0.005, (other.name, 1e3 * error)
        assert np.abs(found.from_gauge(found.to_gauge(probe)) - probe).max() < 1e-6
        assert found.limit_s == pytest.approx(
            0.025 + 0.1 / min(gauge_rate, path_rate if other is path else image_rate), rel=0.01
        )
        # the error that is told is that of the offset
        assert abs(error.mean()) < 2 * found.error_s


def test_nothing_is_filled_in_where_samples_were_dropped():
    times = np.concatenate([np.arange(0, 1, 0.1), np.arange(3, 4, 0.1)])
    one = Recording("gauge", times, times[:, None])
    assert len(one.lapses) == 1 and one.lapses[0] == pytest.approx(2.1)
    assert np.isnan(one.at(np.array([2.0, -0.1, 4.2]))).all()
    np.testing.assert_allclose(one.at(np.array([0.25, 3.55]))[:, 0], [0.25, 3.55])


def test_alike_presses_evenly_apart_are_told():
    times = np.arange(0, 120, 0.02)
    pressed = np.maximum(np.sin(2 * np.pi * times / 10), 0.0)
    found = match_clock(
        Recording("gauge", times, pressed[:, None]), Recording("path", times - 3, pressed[:, None]), 0.1
    )
    assert found.rival


def test_four_times_the_presses_halve_the_error_that_is_told():
    """Each press is off by the same, to one side and the other, but for the error of rounding."""
    told = []
    for count in (6, 24):
        starts = np.cumsum(np.random.default_rng(4).uniform(4, 9, count))
        times = np.arange(0, starts[-1] + 5, 0.01)
        press = sum(np.maximum(1.0 - ((times - at) / (1.0 + 0.02 * k)) ** 2, 0.0) for k, at in enumerate(starts))
        late = np.interp(times, starts, 0.02 * (-1.0) ** np.arange(count))
        found = match_clock(
            Recording("gauge", times, press[:, None]), Recording("path", times + late, press[:, None]), 0.1
        )
        told.append(np.sqrt(found.error_s**2 - (0.1 * 0.01) ** 2))
    assert 0.42 < told[1] / told[0] < 0.58


def test_recordings_that_cannot_serve_are_refused():
    def matched(times, values):
        one = Recording("gauge.csv", np.array(times, float), np.array(values, float)[:, None])
        match_clock(one, one, 0.1)

    for times, values, said in (
        ([0, 1, 1, 2], [0, 1, 1, 0], "does not increase"),
        ([0], [1], "two at least"),
        (np.arange(100) / 10, np.zeros(100), "no press"),
        (np.arange(100) / 10, -np.ones(100), "sign"),
    ):
        refused(said, matched, times, values)


def test_what_a_gauge_reads_at_rest_is_taken_off():
    """Each force was short by it, and presses seemed to begin early."""
    for start, drift in ((-0.3, 0.0), (2.0, 0.0), (-1.0, -0.4)):  # N
        rng = np.random.default_rng(1)
        at = sampled(80, rng, dropped=0.02)
        level = (start + drift * at / LENGTH)[:, None] * [-1.0, 1.0, 1.0]
        forces = np.column_stack([force(at), np.zeros(len(at)), -force(at)])
        read = forces + level + rng.normal(0, 0.02, forces.shape)
        found = without_level(Recording("gauge", at, read), 0.1)
        assert np.abs(found.gauge.values - forces).max() < 0.12, start
        assert np.abs(found.level - level).max() < 0.03, start


def test_a_gauge_of_the_other_sign_is_refused():
    rng = np.random.default_rng(2)
    at = sampled(80, rng)
    pulls = Recording("g", at, (-force(at) + rng.normal(0, 0.02, len(at)))[:, None])
    refused("give --sign -1", without_level, pulls, 0.1)


def told_of_path(tmp_path, text, origin=(0.0, 0.0, 0.0), name="path.log"):
    (tmp_path / name).write_text(text)
    return read_path(tmp_path / name, origin)


def test_units_and_reports_of_one_frame_are_read(tmp_path):
    (tmp_path / "gauge.csv").write_text("# of the lab\ntime_ms,fz_gf\n0,0\n10,-102\n20,-204\n")
    gauge, measured = read_gauge(tmp_path / "gauge.csv", 1)
    assert measured == ("fz_n",)
    np.testing.assert_allclose(gauge.times, [0, 0.01, 0.02])
    np.testing.assert_allclose(gauge.values[:, 0], [0, 1.0003, 2.0006], atol=1e-3)
    work = "0.5 <Idle|WPos:1.000,2.000,5.000|FS:0,0>\n0.6 <Run|WPos:1.000,2.000,4.500|FS:0,0|Ov:100,100,100>\n"
    machine = "0.5 <Idle|MPos:-99.000,-48.000,-5.000|FS:0,0>\n\n0.6 <Jog|MPos:-99.000,-48.000,-5.500|WCO:-100.000,-50.000,-10.000>\n"
    for text in (work, machine):
        path = told_of_path(tmp_path, text, (1.0, 2.0, 5.0))
        np.testing.assert_allclose(path.times, [0.5, 0.6])
        np.testing.assert_allclose(path.values[:, :4], [[0.0, 0, 0, 0], [0.5, 0, 0, -0.5]], atol=1e-9)
    for text in (  # more axes that stand still, fewer decimals, grblHAL's states, dates
        work.replace("000|", "000,0.000|").replace("500|", "500,0.000|"),
        work.replace("000", "00").replace("500", "50"),
        work.replace("Run", "Run:2").replace("Idle", "Tool"),
        work.replace("0.5 ", "1970-01-01T00:00:00.5Z ").replace("0.6 ", "1970-01-01T00:00:00.600+00:00 "),
    ):
        path = told_of_path(tmp_path, text, (1.0, 2.0, 5.0))
        np.testing.assert_allclose(path.times, [0.5, 0.6])
        np.testing.assert_allclose(path.values[:, :4], [[0.0, 0, 0, 0], [0.5, 0, 0, -0.5]], atol=1e-9)
    inches = told_of_path(tmp_path, "time_ms,x_in,y_mm,z_mm\n0,1,0,0\n20,1.0,0,-1e-1\n", name="path.csv")
    np.testing.assert_allclose(inches.values[:, 1], 25.4)


LINE = "0.5 <Idle|WPos:1.000,2.000,5.000|FS:0,0>\n"
CSV = "time_s,x_mm,y_mm,z_mm\n0.00,1,2,5\n"
COMMANDED = "line 2.*commanded positions, not measured ones"
NO_PATHS = {  # what a path may not be, and what is said of it
    "G-code": ("0.5 G1 X1 Y2 Z5 F100\n", "line 1.*commanded positions, not measured ones"),
    "packed words": (LINE + "0.6 G20G90\n", COMMANDED),
    "a jog": (LINE + "0.6 $J=G21G91X1F500\n", COMMANDED),
    "padded": (LINE + "0.6 G020\n", COMMANDED),
    "spaced": (LINE + "0.6 G 91\n", "line 2"),
    "an axis alone": (LINE + "0.6 X1.5 Z-0.5\n", "line 2"),
    "two frames": (LINE + "0.6 <Idle|MPos:1.000,2.000,5.000|FS:0,0>\n", "line 2.*one frame of coordinates"),
    "machine alone": (LINE.replace("WPos", "MPos") * 1, "MPos without any WCO"),
    "zero moved": (
        LINE.replace("|FS", "|WCO:0.000,0.000,1.000|FS") + LINE.replace("|FS", "|WCO:0.000,0.000,2.000|FS"),
        "line 2.*origin of the work coordinates was moved",
    ),
    "inches": ("0.5 <Idle|WPos:0.0394,0.0787,0.1969|FS:0,0>\n", "line 1.*inches"),
    "homing state": (LINE + "0.6 <Home|WPos:1.000,2.000,5.000|FS:0,0>\n", "line 2.*resets its zero"),
    "old GRBL": (LINE + "0.6 <Idle,MPos:1.000,2.000,5.000,WPos:1.000,2.000,5.000>\n", "line 2.*not a report"),
    "no time": ("<Idle|WPos:1.000,2.000,5.000|FS:0,0>\n", "line 1.*time in s first"),
    "a cut line": (LINE + "0.6 <Idle|WPos:1.000,2.000,5.0\n", "line 2.*not a report"),
    "ok": (LINE + "0.6 ok\n", "line 2.*only reports"),
    "exponents": (LINE + "0.6 <Idle|WPos:1.0e1,2.000,5.000|FS:0,0>\n", "line 2.*not a report"),
    "decimal commas": (LINE + "0,6 <Idle|WPos:1.000,2.000,5.000|FS:0,0>\n", "line 2.*not a report"),
    "four axes after three": (LINE + "0.6 <Idle|WPos:1.000,2.000,5.000,0.000|FS:0,0>\n", "line 2.*another axis"),
    "a fourth axis that turns": (
        LINE.replace("5.000|", "5.000,0.000|") + "0.6 <Idle|WPos:1.000,2.000,5.000,9.000|FS:0,0>\n",
        "line 2.*another axis",
    ),
    "time of day": ("12:34:56.789 -> <Idle|WPos:1.000,2.000,5.000|FS:0,0>\n", "line 1.*time of day"),
    "hours, minutes, seconds": ("time_s,x_mm,y_mm,z_mm\n12:00:01,1,2,5\n", "line 2.*time of day"),
    "whole seconds": (
        "time_utc,x_mm,y_mm,z_mm\n2026-01-01T00:00:00,1,2,5\n2026-01-01T00:00:00,1,2,5\n2026-01-01T00:00:01,1,2,5\n",
        "whole seconds only",
    ),
    "six digits": (
        "time_s,x_mm,y_mm,z_mm\n1.73234e+09,1,2,5\n1.73234e+09,1,2,5\n1.73234e+09,1,2,5\n",
        "with six digits .1.73234e.09.: write all of them",
    ),
    "nanoseconds without zeros": (
        "time_s,x_mm,y_mm,z_mm\n1.900000000,1,2,5\n2.5000000,1,2,5\n2.25000000,1,2,5\n",
        "nanoseconds without leading zeros",
    ),
    "the end of daylight saving time": (
        "time_utc,x_mm,y_mm,z_mm\n2026-10-25T02:59:59.9,1,2,5\n2026-10-25T02:00:00.1,1,2,5\n2026-10-25T02:00:00.3,1,2,5\n",
        "daylight saving",
    ),
    "M114": ("X:1.00 Y:2.00 Z:5.00 E:0.00 Count X:80 Y:160 Z:2000\n", "M114 reports the commanded position"),
    "M114 behind its time": ("0.5 X:1.00 Y:2.00 Z:5.00 E:0.00 Count X:80\n", "line 1"),
    "no header": ("0.00,1,2,5\n0.02,1,2,5\n", "no header"),
    "header below": ("controller,grbl,1.1,h\n" + CSV, "header is in line 2"),
    "another column": ("time_s,x_mm,y_mm,z_mm,mode\n0.00,1,2,5,G90\n0.02,1,2,4,G91\n", "'mode' is not known"),
    "two frames of samples": (CSV + "0.02,-99,-48,-5\n", "line 3.*jumps by"),
    "commas for points": (CSV + "0.02,1,0,2,5\n", "row 3|another number"),
    "a line a move": (CSV + "3.20,1,2,-1\n6.40,1,2,5\n", "whole move"),
    "a row of units": ("time_s,x_mm,y_mm,z_mm\ns,mm,mm,mm\n0,1,2,5\n", "line 2.*row of units: remove it"),
    "two headers": (CSV + CSV, "line 3"),
    "semicolons and commas": (CSV.replace(",", ";").replace(".", ","), "separated by"),
    "thousands": (CSV + "0.02,1,234.5,2,5\n", "another number"),
    "radians": ("time_s,x_mm,y_mm,z_mm,rot_rad\n0,1,2,5,0\n0.02,1,2,5,0\n", "'rot_rad' is not known"),
    "a time without a unit": ("time,x_mm,y_mm,z_mm\n0,1,2,5\n0.02,1,2,5\n", "0 time columns"),
    "two logs in one": (CSV + "0.02,1,2,5\n0.00,1,2,5\n", "time does not increase"),
    "words": (CSV + "0.02,1,2,five\n", "'five'"),
    "no unit": ("time_s,x,y,z\n0,1,2,5\n0.02,1,2,5\n", "columns x_UNIT"),
    "two times": ("time_s,time_ms,x_mm,y_mm,z_mm\n0,0,1,2,5\n0.02,20,1,2,5\n", "2 time columns"),
}


def test_a_path_that_may_be_meant_otherwise_is_refused_by_line(tmp_path):
    """A reader that guesses was wrong without a word in twelve of thirty of these."""
    for text, said in NO_PATHS.values():
        refused(said, told_of_path, tmp_path, text)


def test_a_gauge_log_that_cannot_be_read_names_its_cause(tmp_path):
    for text, said in (
        ("time_s,fz\n0,1\n", "fz_UNIT"),
        ("time_s,fz_n,fz_gf\n0,1,1\n", "2 columns"),
        ("t,fz_n\n0,1\n", "time_s"),
        ("time_ms,fz_n\n0,0\n20000,1\n40000,0\n", "one reading every 20 s.*another unit"),
        ("time_s,fz_n\n0,one\n1,2\n", "'one'"),
        ("time_s,fz_n\nnow,1\n", "line 2"),
        ("0.0,1.2\n0.1,1.3\n", "no header"),
        ("gauge of the lab\nserial 12\ntime_s,fz_n\n0,1\n1,1\n", "header is in line 3"),
    ):
        (tmp_path / "gauge.csv").write_text(text)
        refused(said, read_gauge, tmp_path / "gauge.csv", 1)


def test_positions_that_were_sent_ahead_of_the_tip_are_named():
    """By 0.2 to 1.5 s, another time in each press: its error was told as 137 ms."""
    rng = np.random.default_rng(3)
    at = sampled(80, rng)
    gauge = Recording("gauge", at, (force(at) + rng.normal(0, 0.02, len(at)))[:, None])
    for low, high in ((0.2, 1.5), (0.05, 0.3)):
        lead = np.interp(at, STARTS, rng.permutation(np.linspace(low, high, len(STARTS))))
        times = np.maximum.accumulate(at - lead + 1e-6 * np.arange(len(at)))
        path = Recording("path", times, -height(at)[:, None])
        refused("commanded positions logged", match_clock, gauge, path, 0.1)


def test_a_film_whose_frame_rate_is_wrong_is_named():
    rng = np.random.default_rng(4)
    at, seen = sampled(80, rng), sampled(22, rng)
    gauge = Recording("gauge", at, (force(at) + rng.normal(0, 0.02, len(at)))[:, None])
    film = Recording("film", seen * 22 / 25, np.maximum(-height(seen), 0.0)[:, None])
    refused("frame rate", match_clock, gauge, film, 0.1)


def lay_bench(folder, name, seconds, began=0.0, origin=(-120.5, -88.2, -35.4)):
    """Files of a bench as `gelforge align` reads them: a path that is logged only where it moves, small images."""
    gauge_rate, path_rate, _, delay, ppm, dropped, _ = BENCHES[name]
    rng = np.random.default_rng(len(name))
    at = sampled(gauge_rate, rng, dropped)
    at = at[at < seconds]
    readings = force(at) + 0.4 + rng.normal(0, 0.02, len(at))
    lines = [f"{began + t:.4f},{f / 9.80665e-3:.3f}" for t, f in zip(at, readings, strict=True)]
    (folder / "gauge.csv").write_text("\n".join(["time_s,fz_gf", *lines]))
    at = sampled(path_rate, rng)
    at = at[at < seconds]
    z = np.round(height(at), 3)
    moves = np.concatenate([[True], z[1:] != z[:-1]]) | np.concatenate([z[1:] != z[:-1], [True]])
    x, y, top = origin
    lines = [
        f"{1e3 * t:.1f},{x},{y},{h + top:.3f}" for t, h in zip(clock(at, delay, ppm)[moves], z[moves], strict=True)
    ]
    (folder / "path.csv").write_text("\n".join(["time_ms,x_mm,y_mm,z_mm", *lines]))
    (folder / "images").mkdir()
    v, u = np.mgrid[:48, :64] / 48
    blob = 80 * np.exp(-((u - 0.667) ** 2 + (v - 0.5) ** 2) / 0.014)
    taken = np.arange(0.7, seconds - 1.0, 0.1)
    for k, h in enumerate(height(taken)):
        press = 100.5 + max(-h, 0) ** 0.7 * blob + rng.normal(0, 0.3, blob.shape)
        cv2.imwrite(str(folder / f"images/{k}.png"), np.repeat(press[..., None], 3, 2).astype(np.uint8))
    lines = [f"{k}.png,{t:.4f}" for k, t in enumerate(clock(taken, 2 * delay, -ppm))]
    (folder / "images/times.csv").write_text("\n".join(["image,time_s", *lines]))
    return [
        "--gauge", str(folder / "gauge.csv"), "--path", str(folder / "path.csv"), "--images", str(folder / "images"),
        "--data", str(folder / "bench"), "--sensor", "gelsight_mini", "--sign", "-1",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "dated"), [("delayed", 1.79e9), pytest.param("slow gauge", 0.0, marks=pytest.mark.slow)]
)
def test_a_bench_becomes_a_log_that_stage_10_takes_whole(tmp_path, capsys, root, monkeypatch, name, dated):
    """Of 41 rows it rejected 12, sideways forces and moments that nobody measured were 0, and negative origins were no number."""
    monkeypatch.chdir(root)
    words = lay_bench(tmp_path, name, 36.0 if dated else 62.0, dated)
    words += ["--origin", "-120.5,-88.2,-35.4"]
    drawn, save = [], canvas.save_png
    monkeypatch.setattr(canvas, "save_png", lambda path, figure: drawn.append(figure) or save(path, figure))
    command.main([*words, "--indenter", "sphere_15"])
    deviations = drawn[0].axes[1]
    assert "images 35.0 ms" in deviations.get_title()  # 25 ms and a tenth of the interval of the images
    dashed = [line.get_ydata()[0] for line in deviations.lines if line.get_linestyle() == "--"]
    assert dashed[2:] == pytest.approx([-35.0, 35.0], abs=0.1)
    told = capsys.readouterr()
    assert "at rest" in told.out and "the same state as another one" in told.out
    log = tmp_path / "bench/log.csv"
    rows = read_presses(log)
    tables = {each: tomllib.loads((root / f"workflow/{each}.toml").read_text()) for each in ("sensors", "indenters")}
    bodies = Bodies(tables["indenters"], root / "workflow")
    good, wrong = judge_rows(read_log(log), "log.csv", tmp_path / "bench", tables, parameters().poses, bodies)
    assert not wrong and len(good) == len(rows)
    presses = {row.press_id for row in rows}
    assert len(presses) == (2 if dated else 3)
    for row in rows:
        assert (row.x0_mm, row.dx_mm, row.z0_mm) == pytest.approx((0, 0, 0), abs=1e-6)
        assert -row.fz_n == pytest.approx(3.0 * max(-row.dz_mm, 0.0) ** 1.6, abs=0.15)
        assert [row.fx_n, row.fy_n, row.mx_nm, row.my_nm, row.mz_nm] == [None] * 5
        assert row.time_utc.startswith("2026-09-2" if dated else "1970-01-01T00:")
        assert read_image(tmp_path / "bench" / row.image).shape == (240, 320, 3)
    for press in presses:  # the deepest state, where the path says nothing for a second, has its row
        depth = max(-row.dz_mm for row in rows if row.press_id == press)
        assert np.abs(DEPTHS - depth).min() < 0.01
    assert read_image(tmp_path / "bench/nocontact/gelsight_mini.png").mean() == pytest.approx(100, abs=1)
    assert (tmp_path / "bench/aligned.png").stat().st_size > 10_000
    refused("exists already", command.main, [*words, "--indenter", "sphere_15"])
    other = ["--data", str(tmp_path / "other")]
    refused("no indenter named 'sphere_51'", command.main, [*words, *other, "--indenter", "sphere_51"])
    refused("--origin", command.main, [*words[:-2], "--indenter", "sphere_15", *other])


def test_of_one_press_it_is_told_what_its_clocks_may_cost(tmp_path, capsys, root, monkeypatch):
    monkeypatch.chdir(root)
    words = lay_bench(tmp_path, "delayed", 20.0)
    command.main([*words, "--origin", "-120.5,-88.2,-35.4", "--indenter", "sphere_15"])
    told = capsys.readouterr().out
    assert "drift unknown" in told and "one press: the drift of its clocks is unknown; with 1500 ppm" in told


def test_images_of_a_turned_camera_come_into_the_sensors_frame_and_others_are_refused(root):
    sensor = load_sensors(root / "workflow/sensors.toml")["gelsight_mini"]
    rest = read_image(root / "data/demo/nocontact/mini_a.png")
    large = cv2.resize(np.ascontiguousarray(np.rot90(rest)), (480, 640), interpolation=cv2.INTER_CUBIC)
    framed = command.framing(sensor, large, "film: images")(large)
    assert framed.shape == rest.shape and np.abs(framed.astype(int) - rest).mean() < 4.0
    even = np.full((320, 240, 3), 90, np.uint8)
    refused(
        "film: images are 240 x 320; their aspect ratio differs", command.framing(sensor, even, "film: images"), even
    )

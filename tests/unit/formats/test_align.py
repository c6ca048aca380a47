"""Clocks of a bench are matched by what its recordings show of the same presses; nothing is filled in without a word."""

import cv2
import numpy as np
import pytest

from gelforge.commands import align as command
from gelforge.errors import BadInput
from gelforge.formats.align import Recording, match_clock
from gelforge.formats.benchfiles import read_gauge, read_path
from gelforge.records.log import read_presses

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
    "steady": (100, 50, 25, 0.0, 0, 0.0, 0.0),
    "delayed": (100, 50, 25, 0.3, 0, 0.0, 0.2),
    "drifting": (80, 100, 30, 12.0, 50, 0.0, 0.2),
    "with gaps": (100, 40, 25, -0.3, -50, 0.05, 0.2),
    "slow gauge": (20, 100, 60, -47.0, 50, 0.02, 0.1),
}


@pytest.mark.parametrize("name", BENCHES)
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


@pytest.mark.parametrize(
    ("times", "values", "said"),
    [
        ([0, 1, 1, 2], [0, 1, 1, 0], "does not go on"),
        ([0], [1], "two at least"),
        (np.arange(100) / 10, np.zeros(100), "no press"),
        (np.arange(100) / 10, -np.ones(100), "sign"),
    ],
)
def test_recordings_that_cannot_serve_are_refused(times, values, said):
    with pytest.raises(BadInput, match=said):
        one = Recording("gauge.csv", np.array(times, float), np.array(values, float)[:, None])
        match_clock(one, one, 0.1)


def test_units_and_g_code_are_read(tmp_path):
    (tmp_path / "gauge.csv").write_text("# of the lab\ntime_ms,fz_gf\n0,0\n10,-102\n20,-204\n")
    gauge = read_gauge(tmp_path / "gauge.csv", 1)
    np.testing.assert_allclose(gauge.times, [0, 0.01, 0.02])
    np.testing.assert_allclose(gauge.values[:, 0], [0, 1.0003, 2.0006], atol=1e-3)
    (tmp_path / "path.gcode").write_text(
        "; program\n0.0 G21 G90\n0.5 G1 X1 Y2 Z5 F100\n1.0 Z4.5\n1.5 <Run|MPos:1.000,2.000,4.250|FS:0,0>\n"
    )
    path = read_path(tmp_path / "path.gcode", (1.0, 2.0, 5.0))
    np.testing.assert_allclose(path.times, [0.5, 1.0, 1.5])
    np.testing.assert_allclose(path.values[:, 0], [0.0, 0.5, 0.75])
    for text, said in (("time_s,fz\n0,1\n", "fz_UNIT"), ("time_s,fz_n,fz_gf\n0,1,1\n", "2 columns"), ("t,fz_n\n0,1\n", "time_s"),
                       ("time_s,fz_n\n0,one\n1,2\n", "'one'"), ("time_s,fz_n\nnow,1\n", "line 2")):  # fmt: skip
        (tmp_path / "gauge.csv").write_text(text)
        with pytest.raises(BadInput, match=said):
            read_gauge(tmp_path / "gauge.csv", 1)
    (tmp_path / "path.gcode").write_text("0.5 G91 G1 Z-0.5 X0 Y0\n")
    with pytest.raises(BadInput, match="G91"):
        read_path(tmp_path / "path.gcode", (0.0, 0.0, 0.0))


def test_a_bench_becomes_a_dataset(tmp_path, capsys, root):
    rng = np.random.default_rng(5)
    at = sampled(60, rng)
    readings = force(at) + rng.normal(0, 0.02, len(at))
    lines = [f"{t:.4f},{f / 9.80665e-3:.3f}" for t, f in zip(at, readings, strict=True)]
    (tmp_path / "gauge.csv").write_text("\n".join(["time_s,fz_gf", *lines]))
    at = sampled(40, rng)
    lines = [f"{1e3 * t:.1f},12.5,30,{z + 2.0:.3f}" for t, z in zip(clock(at, 0.3, 50), height(at), strict=True)]
    (tmp_path / "path.csv").write_text("\n".join(["time_ms,x_mm,y_mm,z_mm", *lines]))
    film = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (320, 240))
    v, u = np.mgrid[:240, :320]
    for z in height(np.arange(0.0, 60.0, 0.1) + 0.7):
        press = 80 * np.maximum(-z, 0) ** 0.7 * np.exp(-((u - 160) ** 2 + (v - 120) ** 2) / 800)
        film.write(np.repeat((100 + press)[..., None], 3, 2).astype(np.uint8))
    film.release()
    words = {"gauge": "gauge.csv", "path": "path.csv", "images": "film.avi", "data": "bench"}
    argv = [word for name, file in words.items() for word in (f"--{name}", str(tmp_path / file))]
    argv += [
        "--sensor",
        "gelsight_mini",
        "--indenter",
        "sphere_15",
        "--sign",
        "-1",
        "--sensors",
        str(root / "workflow/sensors.toml"),
    ]
    with pytest.raises(BadInput, match="--origin"):  # z = 2 is the apex
        command.main([*argv, "--origin", "12.5,30,0"])
    assert not (tmp_path / "bench").exists()
    command.main([*argv, "--origin", "12.5,30,2"])
    told = capsys.readouterr().out
    assert "drift" in told and "one each 16.7 ms" in told
    rows = read_presses(tmp_path / "bench/log.csv")
    assert {row.press_id for row in rows} == {"p0001", "p0002", "p0003"}
    for row in rows:
        assert (row.x0_mm, row.dx_mm, row.z0_mm) == pytest.approx((0, 0, 0), abs=1e-6)
        assert -row.fz_n == pytest.approx(3.0 * max(-row.dz_mm, 0.0) ** 1.6, abs=0.12)
        assert (tmp_path / "bench" / row.image).exists()
    assert (tmp_path / "bench/nocontact/gelsight_mini.png").exists()
    with pytest.raises(BadInput, match="exists already"):
        command.main([*argv, "--origin", "12.5,30,2"])

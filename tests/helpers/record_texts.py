"""Texts of records as the archives write them, from values, for the tests of reading."""

import math
from pathlib import Path

import numpy as np

from shake_env.records import parse_motion

CICLC = Path(__file__).parents[1] / "data" / "CICLC_trimmed.v1"


def wave(points, scale=0.3, phase=0.0):
    """Values of six decimals that no two lines share."""
    time_ = np.arange(points)
    values = scale * np.sin(0.37 * time_ + phase) * np.exp(-0.01 * time_) + 1e-4 * np.cos(time_**2)
    return np.round(values, 6)


def fortran(values, columns, width, decimals, end="\n"):
    """Text of (columns F width.decimals), with no zero before the point, as CSMIP writes it."""
    cells = [
        f"{v:.{decimals}f}".replace("0.", ".", 1) if abs(v) < 1 else f"{v:.{decimals}f}" for v in values
    ]
    cells = [cell.rjust(width) for cell in cells]
    assert all(len(cell) == width for cell in cells)
    return "".join("".join(cells[i : i + columns]) + end for i in range(0, len(cells), columns))


def at2_text(values, step=".01000", *, header="NPTS= {n:5d}, DT= {step} SEC", unit="G", points=None):
    head = header.format(n=len(values) if points is None else points, step=step)
    cells = [f"{v:15.7E}" for v in values]
    body = "".join("".join(cells[i : i + 5]) + "\n" for i in range(0, len(cells), 5))
    return (
        "PEER NGA STRONG MOTION DATABASE RECORD\nEVENT 10/15/79 2319, STATION 6, 230\n"
        f"ACCELERATION TIME HISTORY IN UNITS OF {unit}\n{head}\n{body}"
    )


NUMBERS = "    1  100    1    3    3  100 -999    3    1    0\n  .0050000  .7071000 319.32000\n"


def v1_channel(values, number=1, label="90 Deg", rate=100, channels=3, **changed):
    n = len(values)
    peak = np.max(np.abs(values))
    line = f"{n:6d} Accelerogram points at {rate} pts/sec in units of g.       Format: (8f9.6)"
    return (
        "Uncorrected Accelerogram Data             Processed: 07/06/19, CGS  made\n"
        f"Station Id. XYZ  35.8N, 117.6W   Q330    s/n 4323  ({channels} Chns of  {channels} at Sta)\n"
        f"Chan {number:2d}:  {label}\n"
        f"No. of Points = {changed.get('points', n):6d}"
        f"  Record Length ={changed.get('length', n / rate):7.3f} sec"
        f"   at {changed.get('header_rate', rate)} Samples/sec\n"
        "Units of uncor data are sec and g.         "
        f"Max  = {changed.get('peak', f'{peak:.3f}')} g, at    1.000 sec.\n"
        f"{NUMBERS}{changed.get('line', line)}\n{fortran(values, 8, 9, 6)}"
        f"/&  ----------  End of Data for Station Channel   {number}  ----------\n"
    )


def v1_text(points=21, channels=3):
    labels = ("90 Deg", "360 Deg", "Up")
    series = [wave(points + k, phase=float(k)) for k in range(channels)]
    text = "".join(
        v1_channel(values, k + 1, labels[k], channels=channels) for k, values in enumerate(series)
    )
    return text, series


def v2_channel(acceleration, number=1, step=".020", channels=2, unit="cm/sec2", **changed):
    n = len(acceleration)
    velocity, displacement = wave(n, 2.0, 0.3), wave(n, 0.5, 0.9)
    counts = {"accel": n, "veloc": n, "displ": n, **changed.get("counts", {})}
    blocks = ""
    for kind, values, u in (
        ("accel", acceleration, unit), ("veloc", velocity, "cm/sec"), ("displ", displacement, "cm"),
    ):  # fmt: skip
        if kind not in changed.get("without", ()):
            blocks += f"{counts[kind]:6d} points of {kind} data equally spaced at  {step} sec"
            blocks += f", in {u}. (8f10.6)\n"
            blocks += fortran(values, 8, 10, 6 if np.max(np.abs(values)) < 100 else 5)
    return (
        f"Corrected accelerogram   XYZ      Chan {number:2d}:  H{number}    from\n"
        "Uncorrected Accelerogram Data             Processed: 04/30/14, CGS  made\n"
        f"Station Id. XYZ     34.0N, 117.9W       s/n 4310  ({channels} Chns of  {channels} at Sta)\n"
        f"Chan {number:2d}:  H{number}\n"
        f"                        Record length ={n * float(step):7.3f} sec.\n"
        "                                     Uncor Max  =   .086 g , at  14.830 sec.\n"
        f"{n:6d} points of instrument- and baseline-corrected accel, veloc and displ data\n"
        f"At equally-spaced intervals of    {changed.get('spacing', step)}  sec.\n"
        f"Peak acceleration = {changed.get('peak', f'{np.max(np.abs(acceleration)):9.3f}')}"
        "    cm/sec/sec  at   1.0   sec.\n"
        f"{NUMBERS}{blocks}/&  ----------  End of data for channel  {number}  ----------\n"
    )


def v2_text(points=19):
    series = [wave(points, 80.0), wave(points, 30.0, 1.0)]
    return "".join(v2_channel(values, k + 1) for k, values in enumerate(series)), series


def knet_text(counts, *, scale="3920(gal)/6182761", rate="100Hz", duration=None, maximum=None):
    above, below = scale.split("(gal)/")
    factor = float(above) / float(below)
    acceleration = np.asarray(counts) * factor
    shown = maximum or f"{np.max(np.abs(acceleration - acceleration.mean())):.3f}"
    lines = [
        ("Origin Time", "2018/01/24 19:51:00"), ("Lat.", "41.0"), ("Long.", "142.5"),
        ("Depth. (km)", "30"), ("Mag.", "6.2"), ("Station Code", "AOM001"),
        ("Station Lat.", "41.5267"), ("Station Long.", "140.9244"), ("Station Height(m)", "39"),
        ("Record Time", "2018/01/24 19:51:43"), ("Sampling Freq(Hz)", rate),
        ("Duration Time(s)", str(len(counts) // 100 if duration is None else duration)), ("Dir.", "N-S"),
        ("Scale Factor", scale), ("Max. Acc. (gal)", shown),
        ("Last Correction", "2018/01/24 19:51:43"), ("Memo.", ""),
    ]  # fmt: skip
    head = "".join(f"{key:<18}{value}\n" for key, value in lines)
    rows = ["".join(f"{c:8d} " for c in counts[i : i + 8]) + "\n" for i in range(0, len(counts), 8)]
    return head + "".join(rows)


def knet_counts(points=100):
    return [13190 + round(4000 * math.sin(0.31 * i) * math.exp(-0.02 * i)) for i in range(points)]


def csv_text(values, step=0.005, title="time [s],acceleration [g]", separator=","):
    rows = (f"{i * step:.3f}{separator}{v:.6f}\n" for i, v in enumerate(values))
    return f"{title}\n" * bool(title) + "".join(rows)


def only(text, **options):
    (record,) = parse_motion("made", text.encode(), **options)
    return record


# One of each, small and right.
AT2 = at2_text(wave(23))
V1 = v1_text()[0]
V2 = v2_text()[0]
KNET = knet_text(knet_counts())
CSV = csv_text(wave(20))

"""Small made-up texts of the formats that have a reader of their own, from values."""

import math

import numpy as np
from record_texts import fortran, wave

STEP = 0.01


def shown(values, decimals):
    return f"{max(values, key=abs):.{decimals}f}"


def integers(values, columns, width):
    cells = [f"{v:{width}d}" for v in values]
    return "".join("".join(cells[i : i + columns]) + "\n" for i in range(0, len(cells), columns))


def reals(values, columns, width, decimals):
    cells = [f"{v:{width}.{decimals}f}" for v in values]
    return "".join("".join(cells[i : i + columns]) + "\n" for i in range(0, len(cells), columns))


def esm_text(values, *, stream="HNE", kind="ACCELERATION", unit="cm/s^2", **changed):
    header = {
        "EVENT_NAME": "MADE UP", "EVENT_ID": "X-1", "NETWORK": "XX", "STATION_CODE": "AAA",
        "STATION_NAME": "Nowhere: hill", "MAGNITUDE_W": "", "SAMPLING_INTERVAL_S": f"{STEP:.6f}",
        "NDATA": len(values), "DURATION_S": f"{len(values) * STEP:.6f}", "STREAM": stream,
        "UNITS": unit, "PGA_CM/S^2": shown(values, 6), "HEADER_FORMAT": "DYNA 1.2",
        "DATA_TYPE": kind, "USER5": "",
        "DATE_TIME_FIRST_SAMPLE_YYYYMMDD_HHMMSS": "20200101_000001.000",
        "DATA_TIMESTAMP_YYYYMMDD_HHMMSS": "20200102_000000.000",
        "INSTRUMENT": "sensor = none | digitizer = none", "STATION_LATITUDE_DEGREE": "40.1",
        "STATION_LONGITUDE_DEGREE": "20.1", "STATION_ELEVATION_M": "1", "FILTER_TYPE": "BUTTERWORTH",
        "FILTER_ORDER": "2", "LOW_CUT_FREQUENCY_HZ": "0.1", "HIGH_CUT_FREQUENCY_HZ": "30.0",
        "INSTRUMENTAL_FREQUENCY_HZ": "", "INSTRUMENTAL_DAMPING": "", "PROCESSING": "manual",
        "BASELINE_CORRECTION": "BASELINE REMOVED",
        **{f"USER{i}": "" for i in range(6, 41)}, **changed,
    }  # fmt: skip
    head = "".join(f"{key}: {text}\n" for key, text in header.items())
    return head + "".join(f"{v:.6f}\n" for v in values)


def cosmos_text(
    values, *, number=1, kind="acceleration", unit="cm/sec2", code=4, stage=2, form="8F10.5",
    channels="( 1 Chns of  3 at Sta)", scnl=None, **changed,
):  # fmt: skip
    n = len(values)
    parameter = {"acceleration": 1, "velocity": 2, "displacement": 3}[kind]
    whole = [-999] * 100
    whole[:4] = stage, parameter, code, 120
    real = [-999.0] * 100
    whole[10:14] = 5, 5, 2, 5
    whole[39], whole[41:45], whole[53] = 2020, [1, 1, 0, 0], 90
    real[0], real[1], real[29] = 40.1, -120.1, 1.0
    real[33], real[61], real[62] = STEP, 1000 * STEP, n * STEP
    real[63] = changed.get("peak", max(values, key=abs))
    comments = ["| made up"] + ([f"|<SCNL>AAA.{scnl}.XX.--"] if scnl else [])
    title = {0: "Raw acceleration counts", 1: "Uncorrected acceleration"}.get(stage, f"Corrected {kind}")
    peak = f"Max = {shown(values, 3):>9} {unit} at    0.100 sec" if kind == "acceleration" else ""
    data = {
        "8F10.5": lambda: reals(values, 8, 10, 5),
        "1E15.6": lambda: "".join(f"{v:15.6E}\n" for v in values),
        "10I8": lambda: integers(values, 10, 8),
    }[form]()
    return (
        f"{title}    (Format v01.20 with 13 text lines)\nRecord of a made-up event\n"
        "Hypocenter: 40.0000 -120.0000 H= 10km Mw=5.0\nOrigin: 2020/01/01 00:00:00 UTC\n"
        "Statn No: 99-0  Code:XX-AAA  Nowhere\nCoords: 40.1000 -120.1000  Site geology:\n"
        f"Recorder: (see comment) s/n {channels} Sensor: none\n"
        "Rcrd start time: 2020/01/01 00:00:01.000 UTC (Q=5) RcrdId: none\n"
        f"Sta Chan   {number}: {90 * number} deg (Rcrdr Chan  {number}) Location:\n"
        "Raw record length =   0.400 sec, Uncor max =     9.000, at   0.100 sec.\n"
        f"Processed: 2020/01/02, {peak}\nNo filtering!\n"
        "Values used when parameter or data value is unknown/unspecified:   -999, -999.0\n"
        f" 100 Integer-header values follow on  10 lines, Format= (10I8)\n{integers(whole, 10, 8)}"
        f" 100 Real-header values follow on  20 lines, Format= (5F15.6)\n{reals(real, 5, 15, 6)}"
        f'   {len(comments)} Comment line(s) follow, each starting with a "|":\n'
        + "".join(f"{c}\n" for c in comments)
        + f"{n:8d} {kind} pts, approx    0 secs, units={unit} ({code:02d}), Format=({form})\n{data}"
        f"End-of-data for Chan  {number} {kind}\n"
    )


def exponential(value):
    """Text of E10.4E1, with one digit of exponent."""
    power = math.floor(math.log10(abs(value))) if value else 0
    mantissa = value / 10.0**power
    return f"{mantissa:.4f}E{power:+d}".rjust(10)


def smc_text(values, *, title="2 CORRECTED ACCELEROGRAM", component="90", sensor=101, **changed):
    whole = [-32768] * 48
    whole[1], whole[14], whole[15] = 2020, sensor, 1
    whole[16] = changed.get("points", len(values))
    real = [1.7e38] * 50
    real[1] = changed.get("rate", 1.0 / STEP)
    real[29], real[31] = changed.get("extremes", (max(values), min(values)))
    cells = [f"{v:15.7E}" for v in real]
    data = [exponential(v) for v in values]
    lines = [
        title, "*", "AAA", "     2020  01  01    0000 Made up, XX", "Moment Mag=      5.0",
        f"station = Nowhere          component= {component:>6}",
        f"epicentral dist =     10.0       pk acc = {abs(max(values, key=abs)):9.3f}",
        "inst type=none       data source = none", "*", "*", "*",
        *integers(whole, 8, 10).split("\n")[:-1],
        *("".join(cells[i : i + 5]) for i in range(0, 50, 5)),
        "|made up",
        *("".join(data[i : i + 8]) for i in range(0, len(data), 8)),
    ]  # fmt: skip
    return "".join(line.ljust(80) + "\n" for line in lines)


def afad_text(values, **changed):
    columns = [values, values / 2, values / 4]
    peaks = " ".join(
        f"({name}) {changed.get(name, np.max(np.abs(column))):.6f}"
        for name, column in zip(("N-S", "E-W", "U-D"), columns, strict=True)
    )
    rows = "".join(f"{a:12.6f} {b:12.6f} {c:12.6f}\n" for a, b, c in zip(*columns, strict=True))
    return (
        "STRONG GROUND MOTION RECORDS OF TURKIYE\nPLACE                   : NOWHERE\n"
        "EARTHQUAKE DATE         : 2020/01/01 00:00:00 (GMT)\n"
        "EPICENTER COORDINATES   : 40.00000N-30.00000E\nEARTHQUAKE DEPTH (km)   : 10.00\n"
        "EARTHQUAKE MAGNITUDE    : 5.0 Mw\nSTATION ID              : 0000\n"
        "STATION COORDINATES     : 40.10000N-30.10000E\nSTATION ALTITUDE (m)    : \n"
        "RECORDER TYPE           : none\nRECORDER SERIAL NO      : 1\n"
        "RECORD TIME             : 01/01/2020 00:00:00.000000 (GMT)\n"
        f"NUMBER OF DATA          : {changed.get('points', len(values))}\n"
        f"SAMPLING INTERVAL (sec) : {STEP}\nRAW PGA VALUES (gal)    : {peaks}\n"
        f"Copyright NOBODY\nNOBODY\n       N-S          E-W          U-D\n{rows}"
    )


def geonet_component(values, name="N90E", volume=1, **changed):
    n = len(values)
    whole = [0] * 40
    whole[8:10], whole[18:20], whole[38:40] = [2020, 1], [1, 0], [2, 1000]
    whole[30 if volume == 1 else 33] = changed.get("points", n)
    blocks = fortran(values, 10, 8, 1)
    if volume == 2:
        whole[34], whole[35] = n, n
        blocks += reals(values / 20, 10, 8, 2) + reals(values / 300, 10, 8, 3)
    real = [0.0] * 60
    real[0], real[24], real[25] = 200.0, 0.005, STEP
    scale = (
        f"Raw readings in units of 1.00 mm/s/s  at intervals of {STEP:.3f} s"
        if volume == 1
        else f"Instrument corrected data at {STEP:.3f} sec intervals"
    )
    kind = "Uncorrected" if volume == 1 else "Corrected"
    peak = changed.get("peak", shown(values, 1))
    return (
        f"{kind} accelerogram 20200101_000000_AAAA_20 GNS Science\n"
        "Site AAAA      40 00 00S  175 00 00E     Basalt file:  20200101_000000_AAAA\n"
        "Nowhere\nInstrument Basalt_0\nResolution: 24-bit   Instr Period: 0.0050 s   Damping: 0.700\n"
        "Accelerogram 20200101_000000_AAAA_20                 Processed 2020 January 02\n"
        "nowhere\n2020 January 01         00:00:00 UT\nEpicentre  40 00 00S 175 00 00E  Dist   10km\n"
        f"Number of points  {n}    Duration {(n - 1) * STEP:.2f} sec\n{scale}\nData is unfiltered\n"
        f"Component {name}\nAcceleration:  Peak {peak:>8} mm/s/s at   0.10 s     RMS   10.00 mm/s/s\n"
        "Velocity record unevaluated\nDisplacement record unevaluated\n"
        f"{integers(whole, 10, 8)}{reals(real, 10, 8, 3)}{blocks}"
    )


def geonet_text(values, volume=1, **changed):
    return "".join(
        geonet_component(values if name == "N90E" else -values, name, volume, **changed)
        for name in ("N90E", "N00E", "Up")
    )


def cwa_text(values, *, data="4F10.3", rate=100, **changed):
    columns = [values, values / 2, -values]
    peaks = "".join(
        f"#AmplitudeMAX. {name}: {changed.get(name, f'{max(c):8.3f}~ {min(c):8.3f}')}\n"
        for name, c in zip("UNE", columns, strict=True)
    )
    rows = "".join(
        "".join(f"{v:10.3f}" for v in (i * STEP, *row)) + "\n"
        for i, row in enumerate(zip(*columns, strict=True))
    )
    return (
        "#Earthquake Information\n#Origin Time(GMT+08): 2020/01/01-00:00:00\n"
        "#EpicenterLongitude(E): 121.0\n"
        "#EpicenterLatitude(N): 24.0\n#Depth(km): 10.0\n#Magnitude(Ml): 6.0\n\n"
        "#Station Information\n#StationCode: AAA\n#StationName: Nowhere\n#StationLongitude(E): 121.0\n"
        "#StationLatitude(N): 23.0\n#InstrumentKind: FBA\n#StartTime(GMT+08): 2020/01/01-00:00:01.000\n"
        f"#RecordLength(sec): {changed.get('length', len(values) * STEP):g}\n#SampleRate(Hz): {rate}\n"
        f"#AmplitudeUnit:  gal. DCoffset(corr)\n{peaks}#DataSequence: Time U(+); N(+); E(+)\n"
        f"#Data: {data} \n{rows}"
    )


def caltech_header(first, texts, whole, real):
    return (
        "".join(f"{line}\n" for line in (first, *texts)) + integers(whole, 16, 5) + reals(real, 8, 10, 3)
    )


def cdmg_volume_1(values, times, *, wide=False, unit="G/10", number=1, **changed):
    """Text of pairs; `values` in g."""
    n = len(values)
    scale = 10.0 if unit == "G/10" else 1.0
    length = changed.get("length", times[-1])
    texts = [
        "MADE-UP EARTHQUAKE", f"CHAN  {number}:  90 DEG",
        f"NO. OF POINTS = {n:6d}  RECORD LENGTH ={length:7.3f} SEC",
        f"UNITS OF UNCOR ACCEL ARE SEC AND {unit}."
        f"     MAX  = {changed.get('peak', shown(values, 3))} G, AT   .100 SEC.",
        f"RMS ACCEL OF COMPLETE RECORD = {changed.get('rms', np.sqrt(np.mean(values**2))):.3f} G.",
    ]  # fmt: skip
    cells = [f"{v:7.3f}" for pair in zip(times, scale * values, strict=True) for v in pair]
    rows = ["".join(cells[i : i + 10]) for i in range(0, len(cells), 10)]
    body = "".join(f"{' ' * wide}{row}\n" for row in rows)
    head = caltech_header(
        "UNCORRECTED ACCELEROGRAM DATA              PROCESSED: 07/16/98, CDMG 13160",
        texts, [0] * 100, [0.0] * 50,
    )  # fmt: skip
    return f"{head}{body}/&  ----------  END OF DATA FOR CHANNEL  {number}  ----------\n"


def cdmg_volume_2(values, **changed):
    n = len(values)
    peaks = (
        f"PEAK ACCELERATION = {changed.get('peak', shown(values, 5))} CMS/SEC/SEC AT 2.1200 SEC",
        f"PEAK VELOCITY = {shown(values / 20, 5)} CMS/SEC AT 2.1800 SEC",
        f"PEAK DISPLACEMENT = {shown(values / 300, 5)} CMS AT 8.5800 SEC",
    )
    texts = ["MADE-UP EARTHQUAKE", "COMP N90E", f"{n} INSTRUMENT AND BASELINE CORRECTED DATA",
             f"AT EQUALLY-SPACED INTERVALS OF  {STEP:.2f} SEC.", *peaks]  # fmt: skip
    head = caltech_header("CORRECTED ACCELEROGRAM   II000  40.000.0", texts, [0] * 100, [0.0] * 100)
    return head + "".join(reals(v, 8, 10, 3) for v in (values, values / 20, values / 300))


VALUES = np.round(100.0 * wave(43), 3)
DECIMAL = np.round(100.0 * wave(43), 1)
TIMES = STEP * np.arange(43)
EVEN = np.round(wave(43), 3)
# One of each, small and right.
FORMATS = {
    "esm": esm_text(VALUES),
    "cosmos": cosmos_text(VALUES, kind="velocity", code=5, unit="cm/sec") + cosmos_text(VALUES),
    "smc": smc_text(VALUES),
    "afad": afad_text(VALUES),
    "geonet 1": geonet_text(DECIMAL),
    "geonet 2": geonet_text(DECIMAL, volume=2),
    "cwa": cwa_text(VALUES),
    "cdmg 1": cdmg_volume_1(EVEN, TIMES),
    "cdmg 2": cdmg_volume_2(VALUES),
}

"""Tables of the players and decoders, from the latest record of each."""

from __future__ import annotations

FRAMES = {
    "splatreel": "`<splat-reel>`",
    "three": "`@splatreel/three`",
    "playcanvas-reel": "`@splatreel/playcanvas`",
    "spark": "Spark 2.2, static splats",
    "playcanvas": "PlayCanvas 2.23, static splats",
    "gaussian-splats-3d": "GaussianSplats3D 0.4.7, static splats",
}
"""Players of `benchmarks/player/run.py`, in the order of the rows."""
DECODERS = ("@splatreel/decoder", "fourdgs", "SPZ per frame, three.js")
LOOPS = {"splatreel": "`<splat-reel>`", "three": "`@splatreel/three`"}


def frame_table(records: dict[str, dict]) -> str:
    """Return the table of frame times in one browser."""
    found = {name: record for name in FRAMES if (record := records.get(f"frame times {name}"))}
    if not found:
        return "*not measured*"
    rows = [
        f"| {FRAMES[name]} | {record['ratio']:.2f} | {_milliseconds(record['frame_ms'])} "
        f"({', '.join(map(_milliseconds, record['frame_ms_of_rounds']))}) | {record['psnr']:.1f} |"
        for name, record in found.items()
    ]
    head = ["| | time of a frame, relative | ms, best round (all rounds) | PSNR dB |", "|---|---|---|---|"]
    last = next(iter(found.values()))
    width, height = last["size"]
    label = f"{last['points']:,} points at {width}x{height}: {last['note']}. {last['machine']}; commit `{last['revision']}`."
    return "\n".join([*head, *rows, "", label])


def _milliseconds(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def decoder_table(records: dict[str, dict]) -> str:
    """Return the table of decoders without a renderer."""
    found = {name: record for name in DECODERS if (record := records.get(f"decoder {name}"))}
    if not found:
        return "*not measured*"
    head = "| | files, MB | decode a group, ms | with all frames as arrays, ms | memory, MB |"
    rows = [
        f"| {name} | {record['file_bytes'] / 1e6:.2f} | {record['decode_ms_per_group']:.0f} "
        f"| {record['all_ms_per_group']:.0f} | {record['memory_bytes'] / 1e6:.0f} |"
        for name, record in found.items()
    ]
    last = next(iter(found.values()))
    label = f"{last['frames']} frames in {last['groups']} groups: {last['note']}. {last['machine']}; commit `{last['revision']}`."
    return "\n".join([head, "|---|---|---|---|---|", *rows, "", label])


def loop_table(records: dict[str, dict]) -> str:
    """Return the table of what a page holds while a reel loops for ten minutes of its time."""
    found = {name: record for name in LOOPS if (record := records.get(f"loop {name}"))}
    if not found:
        return "*not measured*"
    head = "| | seconds of the reel | heap after a minute, MB | at the end, MB | textures | buffers | framebuffers | groups |"
    rows = []
    for name, record in found.items():
        second, last = record["samples"][1], record["samples"][-1]
        held = [f"{second[kind]} → {last[kind]}" for kind in ("Texture", "Buffer", "Framebuffer", "groups")]
        heap = f"{second['heap_bytes'] / 1e6:.2f} | {last['heap_bytes'] / 1e6:.2f}"
        rows.append(f"| {LOOPS[name]} | {last['seconds']} | {heap} | {' | '.join(held)} |")
    last = next(iter(found.values()))
    label = f"{last['note'].capitalize()}, at {last['rate']:g} times the speed. {last['machine']}; commit `{last['revision']}`."
    return "\n".join([head, "|---|---|---|---|---|---|---|---|", *rows, "", label])

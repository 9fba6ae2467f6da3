"""Cameras that Agisoft Metashape exports as XML (File > Export > Export Cameras).

A camera's `transform` [4, 4] is camera to world in OpenCV's axes, in the chunk's own units. A lens has one focal length
f, and the principal point cx, cy as an offset from the image's center. The center of the first pixel is at (0.5, 0.5).
Against OpenCV, p1 and p2 are exchanged, and k4 multiplies the eighth power of the radius. b1 is added to the focal
length of x, and b2 is the skew.

In a multi-camera system, the `master_id` of a slave camera names the camera with the transform. The slave's sensor has
a `rotation` [3, 3] from the slave's axes to the master's, and a `location` in the master's axes, in the chunk's units.

Source: Agisoft Metashape User Manual 1.5, appendix "Camera models"; the XML as nerfstudio's `metashape_utils.py` (commit
50e0e3c) reads it; Metashape Expert Manual (photogrammetrycommunity), "The slave-sensor transform".
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.readers.calibrations.calibrated_rig import (
    Rig,
    RigCamera,
    brown_lens,
    floats,
    image_size,
    naming,
    pose,
    read_xml,
)
from splatreel.capture.readers.colmap_model import import_pycolmap

COEFFICIENTS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")


def is_metashape(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of cameras from Metashape."""
    return file.suffix.lower() == ".xml" and b"<document" in head and b"<chunk" in head and b"<sensor" in head


def read_metashape(file: Path) -> Rig:
    """Return the aligned cameras. Others are left out."""
    chunks = read_xml(file).findall("chunk")
    if len(chunks) != 1:
        raise CaptureError(f"{file}: holds {len(chunks)} chunks. Export the cameras of one chunk.")
    sensors = {sensor.get("id"): sensor for sensor in chunks[0].iterfind("sensors/sensor")}
    nodes = {node.get("id"): node for node in chunks[0].iterfind("cameras//camera")}
    lenses: dict[str | None, tuple[tuple[int, int], Any]] = {}
    cameras, unaligned, components = [], [], set()
    for node in nodes.values():
        label = node.get("label", "")
        if node.get("enabled") in ("0", "false"):
            continue
        sensor, whose = node.get("sensor_id"), f"{file}: camera {label}"
        master = node if node.find("transform") is not None else nodes.get(node.get("master_id"), node)
        place = master.find("transform")
        if place is None:
            unaligned.append(label)
            continue
        components.add(master.get("component_id"))
        if (turned := node.findtext("orientation", "1").strip()) != "1":
            raise CaptureError(
                f"{whose}: its image is turned by the EXIF orientation {turned}. Turn the pixels of the images, and align them again."
            )
        if sensor not in sensors:
            raise CaptureError(f"{whose}: has no sensor. Export the cameras again.")
        owner = f"{file}: sensor {sensors[sensor].get('label', sensor)}"
        if sensor not in lenses:
            lenses[sensor] = _lens(owner, sensors[sensor])
        size, lens = lenses[sensor]
        offset = np.eye(4) if master is node else _offset(f"{owner} of camera {label}", sensors[sensor])
        cameras.append(RigCamera(label, _viewmat(whose, place, offset), size, lambda *_, lens=lens: lens))
    if len(components) > 1:
        raise CaptureError(
            f"{file}: its cameras were aligned in {len(components)} components, whose places relative to each other are unknown. Align "
            f"all cameras together."
        )
    notes = [f"{file}: not aligned, and left out: {', '.join(unaligned)}"] if unaligned else []
    return Rig(file, cameras, notes=notes)


def _offset(whose: str, sensor: Element) -> np.ndarray:
    """Return the place of a slave sensor in its master's axes, [4, 4]."""
    if sensor.find("rotation") is None or sensor.find("location") is None:
        raise CaptureError(
            f"{whose}: belongs to a multi-camera system, but has no rotation and location in it. Optimize the cameras with the slave "
            f"offsets (Tools > Camera Calibration), and export them again."
        )
    offset = np.eye(4)
    with naming(whose):
        offset[:3, :3] = floats(sensor.findtext("rotation"), 9).reshape(3, 3)
        offset[:3, 3] = floats(sensor.findtext("location"), 3)
    return offset


def _viewmat(whose: str, place: Element, offset: np.ndarray) -> np.ndarray:
    with naming(whose):
        matrix = floats(place.text, 16).reshape(4, 4) @ offset
        axes, center = matrix[:3, :3], matrix[:3, 3]
    return pose(whose, axes.T, -axes.T @ center)


def _lens(whose: str, sensor: Element) -> tuple[tuple[int, int], Any]:
    """Return the image size and the lens of a sensor: the adjusted one, otherwise the initial one."""
    found = sensor.findall("calibration")
    node = next((one for one in found if one.get("class") == "adjusted"), found[0] if found else None)
    if node is None:
        raise CaptureError(f"{whose}: is not calibrated. Align the cameras, and export them again.")
    kind = node.get("type", sensor.get("type", "frame"))
    with naming(whose):
        shape = node.find("resolution")
        if shape is None:
            shape = sensor.find("resolution")
        if shape is None:
            raise KeyError("resolution")
        size = image_size([float(shape.attrib["width"]), float(shape.attrib["height"])])
        value = {key: floats(node.findtext(key), 1)[0] if node.find(key) is not None else 0.0 for key in COEFFICIENTS}
    if value["p3"] or value["p4"] or value["f"] <= 0 or kind not in ("frame", "fisheye"):
        raise CaptureError(
            f"{whose}: is {kind} with f {value['f']:g}, p3 {value['p3']:g} and p4 {value['p4']:g}. Read are frame and fisheye lenses "
            f"with a focal length, without p3 and p4: fix these at 0 and optimize the cameras again."
        )
    pinhole = [value["f"] + value["b1"], value["f"], size[0] / 2 + value["cx"], size[1] / 2 + value["cy"]]
    radial = [value[f"k{order}"] for order in (1, 2, 3, 4)]
    if kind == "frame":
        return size, brown_lens(whose, size, pinhole, radial, [value["p2"], value["p1"]], value["b2"])
    if value["p1"] or value["p2"] or value["b2"]:
        raise CaptureError(
            f"{whose}: is a fisheye with p1 {value['p1']:g}, p2 {value['p2']:g} and b2 {value['b2']:g}. Fix them at 0 and optimize the "
            f"cameras again."
        )
    camera = import_pycolmap().Camera(model="OPENCV_FISHEYE", width=size[0], height=size[1], params=[*pinhole, *radial])
    return size, camera

"""Script for Blender's Python that turns the arrays of `blend_export` into a .blend file.

It runs in a process of its own, in the program `blender` or in a Python with the module `bpy`, and imports nothing else of Splatreel:

    blender --background --factory-startup --python blender_scene.py -- ARRAYS.npz OUT.blend
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

bpy: Any = sys.modules.get("bpy")
"""Blender's module, which its Python has imported."""
NO_SOUND = "SPLATREEL: this Blender was built without sound"
"""Line of the output for a sound that was left out, as in the module `bpy`."""
_REACH, _FACES = 3.0, 2
"""Radius of a splat in standard deviations, and subdivisions of the icosphere that covers it."""
_CORNERS = 8
"""Corners of the disc."""
_BOUNCES, _KEPT = 1024, 64
"""Surfaces that a ray of Cycles may pass, and those before it may end at random, which is noise."""
_KINDS = {"position": "FLOAT_VECTOR", "rotation": "FLOAT_VECTOR", "color": "FLOAT_VECTOR", "opacity": "FLOAT"}
"""Properties of a Gaussian that move, and the types of their vectors."""


def main() -> None:
    """Write the .blend file that the command line names."""
    source, out = sys.argv[sys.argv.index("--") + 1 :]
    with np.load(source) as file:
        arrays = dict(file)
    description = json.loads(str(arrays.pop("scene")))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"
    scene = bpy.context.scene
    _set_scene(scene, description)
    splats = _splats_tree(description, arrays)
    for number, entry in enumerate(description["objects"]):
        prefix = f"{number}/"
        own = {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
        _add_object(scene, entry, own, splats)
    for number, entry in enumerate(description["cameras"]):
        camera = _add_camera(scene, entry, arrays[f"camera{number}"])
        if number == 0:
            scene.camera = camera
    if description["sound"] and bpy.app.build_options.audaspace:
        _add_sound(scene, description["sound"])
    elif description["sound"]:
        print(NO_SOUND)
    bpy.ops.wm.save_as_mainfile(filepath=out, compress=True, check_existing=False)


def _set_scene(scene: Any, description: Mapping[str, Any]) -> None:
    """Set time, size, color management, background and the limits of Cycles."""
    fps = description["fps"]
    scene.render.fps = max(round(fps), 1)
    scene.render.fps_base = scene.render.fps / fps
    scene.frame_start, scene.frame_end = 0, description["frames"] - 1
    scene.render.resolution_x, scene.render.resolution_y = description["size"]
    scene.view_settings.view_transform = "Standard"
    if hasattr(scene, "cycles"):
        scene.cycles.transparent_max_bounces, scene.cycles.min_transparent_bounces = _BOUNCES, _KEPT
    world = bpy.data.worlds.new("background")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (*description["background"], 1.0)
    scene.world = world


def _add_object(scene: Any, entry: Mapping[str, Any], arrays: Mapping[str, np.ndarray], splats: Any) -> None:
    """Add a mesh of points with attributes, its motion, and the modifier that draws it."""
    mesh = bpy.data.meshes.new(entry["name"])
    mesh.vertices.add(len(arrays["position"]))
    mesh.attributes["position"].data.foreach_set("vector", arrays["position"].ravel())
    _set_attribute(mesh, "rotation", "QUATERNION", "value", arrays["rotation"])
    _set_attribute(mesh, "scale", "FLOAT_VECTOR", "vector", arrays["scale"])
    _set_attribute(mesh, "color", "FLOAT_VECTOR", "vector", arrays["color"])
    for name in ("opacity", "shown_from", "shown_until"):
        _set_attribute(mesh, name, "FLOAT", "value", arrays[name])
    item = bpy.data.objects.new(entry["name"], mesh)
    scene.collection.objects.link(item)
    if entry["frames"]:
        first, last = entry["frames"]
        for frame, hidden in ((first - 1, True), (first, False), (last + 1, True)):
            item.hide_viewport = item.hide_render = hidden
            item.keyframe_insert("hide_viewport", frame=frame)
            item.keyframe_insert("hide_render", frame=frame)
        motion = _motion_tree(entry["name"], mesh, range(first, last + 1), arrays)
        item.modifiers.new("motion", "NODES").node_group = motion
    item.modifiers.new("splats", "NODES").node_group = splats


def _set_attribute(mesh: Any, name: str, kind: str, key: str, values: np.ndarray) -> None:
    mesh.attributes.new(name, kind, "POINT").data.foreach_set(key, np.ascontiguousarray(values, np.float32).ravel())


def _motion_tree(name: str, mesh: Any, frames: Iterable[int], arrays: Mapping[str, np.ndarray]) -> Any:
    """Return the nodes that add animated values times vectors to position, rotation, color and opacity."""
    tree, geometry, end = _geometry_tree(f"motion of {name}")
    place = _add(tree, "GeometryNodeInputPosition").outputs[0]
    geometry = _store(tree, geometry, "rest_position", "FLOAT_VECTOR", place)
    offsets = {}
    for prop, kind in _KINDS.items():
        total = None
        for number, (curve, vector) in enumerate(
            zip(arrays[f"{prop}_curves"].T, arrays[f"{prop}_vectors"], strict=True)
        ):
            label = f"{prop}_{number}"
            _set_attribute(mesh, label, kind, "value" if kind == "FLOAT" else "vector", vector)
            value = _add(tree, "ShaderNodeValue", name=label, label=label).outputs[0]
            _animate(value, frames, curve.tolist())
            node = "ShaderNodeMath" if kind == "FLOAT" else "ShaderNodeVectorMath"
            terms = {0: _attribute(tree, label, kind), 1: value} | ({} if total is None else {2: total})
            if total is None and kind != "FLOAT":
                terms[2] = (0.0, 0.0, 0.0)
            elif total is None:
                terms[2] = 0.0
            total = _add(tree, node, terms, operation="MULTIPLY_ADD").outputs[0]
        offsets[prop] = total
    if offsets["position"]:
        terms = {"Geometry": geometry, "Offset": offsets["position"]}
        geometry = _add(tree, "GeometryNodeSetPosition", terms).outputs[0]
    if offsets["rotation"]:
        angle = _add(tree, "ShaderNodeVectorMath", {0: offsets["rotation"]}, operation="LENGTH").outputs["Value"]
        terms = {"Axis": offsets["rotation"], "Angle": angle}
        turn = _add(tree, "FunctionNodeAxisAngleToRotation", terms).outputs[0]
        terms = {0: _attribute(tree, "rotation", "QUATERNION"), 1: turn}
        turned = _add(tree, "FunctionNodeRotateRotation", terms, rotation_space="LOCAL").outputs[0]
        geometry = _store(tree, geometry, "rotation", "QUATERNION", turned)
    for prop, node in (("color", "ShaderNodeVectorMath"), ("opacity", "ShaderNodeMath")):
        if offsets[prop]:
            terms = {0: _attribute(tree, prop, _KINDS[prop]), 1: offsets[prop]}
            total = _add(tree, node, terms, operation="ADD").outputs[0]
            geometry = _store(tree, geometry, prop, _KINDS[prop], total)
    tree.links.new(geometry, end)
    return tree


def _splats_tree(description: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Any:
    """Return the nodes that fade points in and out, and put an ellipsoid on each.

    A point shows while the animated value `progress` is between its attributes `shown_from` and `shown_until`, and fades for 1 before
    and after.
    """
    tree, geometry, end = _geometry_tree("splats")
    frames = range(description["frames"])
    progress = _add(tree, "ShaderNodeValue", name="progress", label="progress").outputs[0]
    _animate(progress, frames, arrays["progress"].tolist())
    comes = _math(tree, "SUBTRACT", progress, _attribute(tree, "shown_from", "FLOAT"))
    comes = _math(tree, "ADD", comes, 1.0, clamp=True)
    goes = _math(tree, "SUBTRACT", progress, _attribute(tree, "shown_until", "FLOAT"), clamp=True)
    weight = _math(tree, "SUBTRACT", comes, goes)
    opacity = _math(tree, "ADD", _attribute(tree, "opacity", "FLOAT"), 0.0, clamp=True)
    clear = _math(tree, "SUBTRACT", 1.0, _math(tree, "MINIMUM", opacity, 0.9999))
    opacity = _math(tree, "SUBTRACT", 1.0, _math(tree, "POWER", clear, weight))
    channels = _add(tree, "ShaderNodeSeparateXYZ", {0: _attribute(tree, "color", "FLOAT_VECTOR")}).outputs
    light = arrays.get("light")
    colors = {"Alpha": opacity}
    for number, name in enumerate(("Red", "Green", "Blue")):
        color = channels[number]
        if light is not None:
            value = _add(tree, "ShaderNodeValue", name=f"light {name}", label=f"light {name}").outputs[0]
            _animate(value, frames, light[:, number].tolist())
            color = _math(tree, "MULTIPLY", color, value)
        colors[name] = _linear(tree, color)
    color = _add(tree, "FunctionNodeCombineColor", colors).outputs[0]
    geometry = _store(tree, geometry, "splat", "FLOAT_COLOR", color)
    shows = _math(tree, "GREATER_THAN", opacity, 1 / 255)
    tree.links.new(_instances(tree, geometry, shows, _material()), end)
    return tree


def _instances(tree: Any, points: Any, shows: Any, material: Any) -> Any:
    """Return the nodes that put an ellipsoid on each point for the viewport, and a disc that faces the camera for renders.

    A ray meets the disc in the middle of the Gaussian, so renders blend splats in the right order. The near side of ellipsoids may lie
    before other splats, but ellipsoids look right from anywhere. The disc faces the camera in the space in which the Gaussian is round.
    """
    rotation, scale = _attribute(tree, "rotation", "QUATERNION"), _attribute(tree, "scale", "FLOAT_VECTOR")
    place = _add(tree, "GeometryNodeInputPosition").outputs[0]
    sphere = _add(tree, "GeometryNodeMeshIcoSphere", {"Radius": _REACH, "Subdivisions": _FACES}).outputs["Mesh"]
    corners = {"Vertices": _CORNERS, "Radius": _REACH / float(np.cos(np.pi / _CORNERS))}
    disc = _add(tree, "GeometryNodeMeshCircle", corners, fill_type="NGON").outputs[0]
    viewport = _add(tree, "GeometryNodeIsViewport").outputs[0]
    shape = _add(tree, "GeometryNodeSwitch", {"Switch": viewport, "False": disc, "True": sphere}, input_type="GEOMETRY")
    shape = _add(tree, "GeometryNodeSetMaterial", {"Geometry": shape.outputs[0], "Material": material}).outputs[0]
    camera = _add(tree, "GeometryNodeInputActiveCamera").outputs[0]
    eye = _add(tree, "GeometryNodeObjectInfo", {"Object": camera}, transform_space="RELATIVE").outputs["Location"]
    ray = _add(tree, "ShaderNodeVectorMath", {0: eye, 1: place}, operation="SUBTRACT").outputs[0]
    inverse = _add(tree, "FunctionNodeInvertRotation", {0: rotation}).outputs[0]
    ray = _add(tree, "FunctionNodeRotateVector", {"Vector": ray, "Rotation": inverse}).outputs[0]
    ray = _add(tree, "ShaderNodeVectorMath", {0: ray, 1: scale}, operation="DIVIDE").outputs[0]
    facing = _add(tree, "FunctionNodeAlignRotationToVector", {"Vector": ray}, axis="Z").outputs[0]
    facing = _add(tree, "FunctionNodeCombineTransform", {"Rotation": facing}).outputs[0]
    own = {"Translation": place, "Rotation": rotation, "Scale": scale}
    whole = _add(tree, "FunctionNodeCombineTransform", own).outputs[0]
    whole = _add(tree, "FunctionNodeMatrixMultiply", {0: whole, 1: facing}).outputs[0]
    points = _store(tree, points, "place", "FLOAT4X4", whole)
    terms = {"Points": points, "Selection": shows, "Instance": shape}
    made = _add(tree, "GeometryNodeInstanceOnPoints", terms).outputs[0]
    terms = {"Instances": made, "Transform": _attribute(tree, "place", "FLOAT4X4")}
    return _add(tree, "GeometryNodeSetInstanceTransform", terms).outputs[0]


def _linear(tree: Any, value: Any) -> Any:
    """Return the nodes from an sRGB value to linear light."""
    value = _math(tree, "MAXIMUM", value, 0.0)
    steep = _math(tree, "POWER", _math(tree, "MULTIPLY_ADD", value, 1 / 1.055, 0.055 / 1.055), 2.4)
    dark = _math(tree, "LESS_THAN", value, 0.04045)
    return _add(tree, "ShaderNodeMix", {0: dark, 2: steep, 3: _math(tree, "DIVIDE", value, 12.92)}).outputs[0]


def _material() -> Any:
    """Return a material that emits the color of a splat, with a Gaussian falloff.

    In the space of an instance the splat is a unit Gaussian. The squared distance of a ray from its center is |p|^2 - (p.v)^2, for any
    point p on the ray and its unit direction v. So the faces of the icosphere do not show.
    """
    material = bpy.data.materials.new("splat")
    material.use_nodes = True
    material.use_backface_culling = True
    if hasattr(material, "cycles"):
        material.cycles.emission_sampling = "NONE"  # splats show, but light nothing else
    tree = material.node_tree
    tree.nodes.clear()
    color = _add(tree, "ShaderNodeAttribute", attribute_type="INSTANCER", attribute_name="splat").outputs
    place = _add(tree, "ShaderNodeTexCoord").outputs["Object"]
    surface = _add(tree, "ShaderNodeNewGeometry").outputs
    terms = {"Vector": surface["Incoming"]}
    ray = _add(
        tree, "ShaderNodeVectorTransform", terms, vector_type="VECTOR", convert_from="WORLD", convert_to="OBJECT"
    )
    ray = _add(tree, "ShaderNodeVectorMath", {0: ray.outputs[0]}, operation="NORMALIZE").outputs[0]
    square = _add(tree, "ShaderNodeVectorMath", {0: place, 1: place}, operation="DOT_PRODUCT").outputs["Value"]
    along = _add(tree, "ShaderNodeVectorMath", {0: place, 1: ray}, operation="DOT_PRODUCT").outputs["Value"]
    square = _math(tree, "SUBTRACT", square, _math(tree, "MULTIPLY", along, along))
    falloff = _math(tree, "EXPONENT", _math(tree, "MULTIPLY", square, -0.5))
    alpha = _math(tree, "MULTIPLY", color["Alpha"], falloff)
    alpha = _math(tree, "MULTIPLY", alpha, _math(tree, "SUBTRACT", 1.0, surface["Backfacing"]))
    emission = _add(tree, "ShaderNodeEmission", {"Color": color["Color"]}).outputs[0]
    clear = _add(tree, "ShaderNodeBsdfTransparent").outputs[0]
    mixed = _add(tree, "ShaderNodeMixShader", {0: alpha, 1: clear, 2: emission}).outputs[0]
    _add(tree, "ShaderNodeOutputMaterial", {"Surface": mixed})
    return material


def _add_camera(scene: Any, entry: Mapping[str, Any], poses: np.ndarray) -> Any:
    """Add a camera. poses: [F, 7] location and rotation (wxyz) at the frames of the entry, or [1, 7] for one that does not move."""
    lens = bpy.data.cameras.new(entry["name"])
    lens.sensor_fit, lens.sensor_width = "HORIZONTAL", 36.0
    lens.lens, lens.shift_x, lens.shift_y = entry["lens"], *entry["shift"]
    lens.clip_start = entry["near"]
    lens.clip_end = max(lens.clip_end, 1e4 * entry["near"])
    camera = bpy.data.objects.new(entry["name"], lens)
    camera.rotation_mode = "QUATERNION"
    camera.location, camera.rotation_quaternion = poses[0, :3], poses[0, 3:]
    scene.collection.objects.link(camera)
    if entry["frames"]:
        for frame, pose in zip(entry["frames"], poses, strict=True):
            camera.location, camera.rotation_quaternion = pose[:3], pose[3:]
            camera.keyframe_insert("location", frame=frame)
            camera.keyframe_insert("rotation_quaternion", frame=frame)
    return camera


def _add_sound(scene: Any, file: str) -> None:
    """Add a sound file as a strip that starts at frame 0, packed into the .blend file."""
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    sound = strips.new_sound("sound", file, 1, 0).sound
    sound.pack()
    sound.filepath = "//sound.flac"


def _geometry_tree(name: str) -> tuple[Any, Any, Any]:
    """Return an empty tree of Geometry Nodes, the geometry it gets, and the socket of its result."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    return tree, _add(tree, "NodeGroupInput").outputs[0], _add(tree, "NodeGroupOutput").inputs[0]


def _add(tree: Any, kind: str, inputs: Mapping[Any, Any] | None = None, **properties: Any) -> Any:
    """Add a node. inputs: a socket to link, or a constant, for names or numbers of inputs."""
    count = len(tree.nodes)
    node = tree.nodes.new(kind)
    node.location = (200 * (count % 16), -200 * (count // 16))
    for name, value in properties.items():
        setattr(node, name, value)
    for key, value in (inputs or {}).items():
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, node.inputs[key])
        else:
            node.inputs[key].default_value = value
    return node


def _math(tree: Any, operation: str, *values: Any, clamp: bool = False) -> Any:
    return _add(tree, "ShaderNodeMath", dict(enumerate(values)), operation=operation, use_clamp=clamp).outputs[0]


def _attribute(tree: Any, name: str, kind: str) -> Any:
    return _add(tree, "GeometryNodeInputNamedAttribute", {"Name": name}, data_type=kind).outputs["Attribute"]


def _store(tree: Any, geometry: Any, name: str, kind: str, value: Any) -> Any:
    terms = {"Geometry": geometry, "Name": name, "Value": value}
    return _add(tree, "GeometryNodeStoreNamedAttribute", terms, data_type=kind, domain="POINT").outputs[0]


def _animate(socket: Any, frames: Iterable[int], values: Sequence[float]) -> None:
    """Set keyframes of a socket. A value that does not change needs one."""
    if len(set(values)) == 1:
        values = values[:1]
    for frame, value in zip(frames, values, strict=False):
        socket.default_value = value
        socket.keyframe_insert("default_value", frame=frame)


if __name__ == "__main__":
    main()

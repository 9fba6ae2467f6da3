"""Script for a Python with Blender's module: write the evaluated points of every frame of a .blend file.

    python blend_frames.py SCENE.blend OUT.npz

Arrays of frame F start with F/: position, rotation, scale, splat (linear color and opacity, faded), and group, -1 for static points.
"""

import importlib
import sys
from typing import Any

import numpy as np

bpy: Any = importlib.import_module("bpy")
SIZES = {"position": 3, "rotation": 4, "scale": 3, "splat": 4}
KEYS = {"FLOAT_VECTOR": "vector", "QUATERNION": "value", "FLOAT_COLOR": "color"}


def main() -> None:
    bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
    scene = bpy.context.scene
    tree = bpy.data.node_groups["splats"]
    store = next(node for node in tree.nodes if node.bl_idname == "GeometryNodeStoreNamedAttribute")
    end = next(node for node in tree.nodes if node.bl_idname == "NodeGroupOutput")
    tree.links.new(store.outputs[0], end.inputs[0])  # the points instead of their ellipsoids
    arrays = {}
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        found = {name: [] for name in (*SIZES, "group")}
        for item in scene.objects:
            if item.type != "MESH" or item.hide_viewport:
                continue
            mesh = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
            for name, size in SIZES.items():
                values = np.empty((len(mesh.vertices), size), np.float32)
                attribute = mesh.attributes[name]
                attribute.data.foreach_get(KEYS[attribute.data_type], values.ravel())
                found[name].append(values)
            kind, number = item.name.split()
            found["group"].append(np.full(len(mesh.vertices), int(number) if kind == "group" else -1))
        arrays |= {f"{frame}/{name}": np.concatenate(parts) for name, parts in found.items()}
    np.savez(sys.argv[2], **arrays)


if __name__ == "__main__":
    main()

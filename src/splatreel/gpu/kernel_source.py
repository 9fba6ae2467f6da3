"""Sources of the kernels: WGSL files of the folder `shaders`, put together for one size of workgroups."""

from __future__ import annotations

import re
from importlib import resources

BINDING = re.compile(r"@binding\((\d+)\) var<(storage, read_write|storage, read|uniform)> (\w+)")
_USES = re.compile(r"^// use: (.*)$", re.MULTILINE)
_SUBGROUP_CALL = "add_up(local, entry.y, sum0, sum1, sum2, lane, number, subgroups, k % 2u);"
_SUBGROUP_ARGUMENTS = (
    ": u32, @builtin(subgroup_invocation_id) lane: u32, @builtin(subgroup_id) number: u32, "
    "@builtin(num_subgroups) subgroups: u32"
)


def read_shader(name: str) -> str:
    """Return the source of a file of the folder `shaders`. name: with its suffix, or without the suffix `.wgsl`."""
    file = name if "." in name else f"{name}.wgsl"
    return (resources.files("splatreel.gpu") / "shaders" / file).read_text(encoding="utf-8")


def complete_source(name: str, group: int, subgroups: bool, **constants: str | int) -> str:
    """Return the complete source of a kernel.

    Args:
        name: File of the folder `shaders`.
        group: Threads of a workgroup.
        subgroups: Sums over a tile use subgroup operations.
        constants: Values of names that the file leaves open.
    """
    text = read_shader(name)
    uses = [part.strip() for line in _USES.findall(text) for part in line.split(",")]
    declared = "".join(f"const {label} = {value};\n" for label, value in constants.items())
    if name == "backward":
        chosen = "subgroups" if subgroups else "tree"
        call = _SUBGROUP_CALL if subgroups else "add_up(local, entry.y, sum0, sum1, sum2);"
        arguments = _SUBGROUP_ARGUMENTS if subgroups else ": u32"
        text = text.replace("SUMS", read_shader(f"backward_{chosen}"))
        text = text.replace("REDUCE", call).replace("SUBGROUP_ARGUMENTS", arguments)
    return "\n".join([f"const GROUP = {group}u;\n", declared, *map(read_shader, uses), text])

"""Writing a reel, group by group; at any moment what is on disk is a valid reel."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np

from splatreel.codec.container import write_atomically
from splatreel.codec.encoder import ReelEncoder
from splatreel.codec.group_file import decode_group, decode_layer
from splatreel.codec.header import ReelHeader
from splatreel.codec.manifest import FileEntry, Manifest, parse_manifest
from splatreel.codec.presentation import EMPTY, Asset, Presentation
from splatreel.config import EncodeConfig
from splatreel.errors import ReelError
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group


class ReelWriter:
    """Encodes layers and groups into the directory `path` and publishes each group in the manifest (docs/format.md).

    For every group, in order: `add_layer` if static points are born at it, then `add_group`. With `resume` the
    groups already published are kept, as far as their files are there; to go on, start with any index up to their number
    (with its layer, if it has one): the group of that index and all later ones are dropped. Without it, a reel that is
    already in `path` is dropped, with what it says for people (`present`).

    header: what the reel says beside its files. config: with renditions, every group is written in each of them; what comes back
    decoded is the best. Raises `ReelError` where files cannot be read or written, and for what no reader takes: before anything is
    encoded.
    """

    def __init__(self, path: str | Path, header: ReelHeader, *, config: EncodeConfig, resume: bool = False) -> None:
        self.path = Path(path)
        self.encoder = ReelEncoder(config)
        self.config = self.encoder.config
        self._pending: FileEntry | None = None
        self._manifest = Manifest(
            **vars(header),
            generator=f"splatreel {metadata.version('splatreel')}",
            live=True,
            frames=0,
            renditions=config.renditions if self.encoder.others else (),
        )
        self._check_header()
        published = self._published()
        if published:
            self._manifest = self._manifest.with_files(list(published.layers), list(published.groups))
            same = published.renditions == self._manifest.renditions
            self._drop_from(self._intact() if resume and same else 0)
            self._manifest = replace(self._manifest, presentation=self._whole(published.presentation))
            if not (resume and same):
                self.present(EMPTY)

    @property
    def manifest(self) -> Manifest:
        """What is published so far."""
        return self._manifest

    def add_layer(
        self,
        group: int,
        first_frame: int,
        gaussians: Gaussians,
        importance: np.ndarray | None = None,
        encoded: tuple[bytes, np.ndarray] | None = None,
    ) -> tuple[Gaussians, np.ndarray]:
        """Encode the static points born at `group`; they are published together with that group.

        importance: [N, 3], how much of the pictures hangs on each point's shape, color and place; None: all alike.
        encoded: what `encoder.layer` gave for the same, if it has been called.

        Returns the decoded points in reel order (train on against these: later groups then absorb the error), and
        order [N]: order[i] is the index of the input point that became reel point i.
        """
        self._check_next(group)
        self._drop_from(group)
        if not len(gaussians):
            return gaussians, np.zeros(0, np.int64)
        uri = f"layers/{group:04d}.safetensors"
        data, order = encoded or self.encoder.layer(group, first_frame, gaussians, importance)
        entry = self._write(uri, data, FileEntry(uri, 0, "", first_frame, 0, len(gaussians), group))
        self._pending = entry
        return decode_layer(data, uri)[1], order

    def add_group(
        self, group: Group, importance: np.ndarray | None = None, encoded: dict[str, bytes] | None = None
    ) -> Group:
        """Encode and publish a group; returns it decoded, its dynamic points in reel order. importance: see `add_layer`.

        encoded: what `encoder.group` gave for the same, if it has been called.

        Raises `ReelError` if its `alive` does not fit the layers.
        """
        self._check_next(group.index)
        pending = self._pending if self._pending and self._pending.group == group.index else None
        self._drop_from(group.index)
        layers = [*self._manifest.layers, *([pending] if pending else [])]
        static = sum(layer.points for layer in layers)
        if group.alive.shape != (static,):
            raise ReelError(
                f"Group {group.index} says of {len(group.alive)} static points whether they are alive, but the layers "
                f"hold {static}. Add the layer of this group before it."
            )
        files = encoded or self.encoder.group(group, importance)
        blank = FileEntry("", 0, "", group.first_frame, group.frames, len(group.dynamic), group.index)
        entry, *others = (self._write(uri, data, replace(blank, uri=uri)) for uri, data in files.items())
        entry = replace(entry, renditions=dict(zip(self.encoder.others, others, strict=True)))
        self._publish(self._manifest.with_files(layers, [*self._manifest.groups, entry]))
        self._pending = None
        return decode_group(files[entry.uri], entry.uri)

    def write_asset(self, uri: str, data: bytes) -> Asset:
        """Write a picture or a piece of sound, for a presentation to name."""
        write_atomically(self.path / uri, data)
        return Asset(uri, len(data), hashlib.sha256(data).hexdigest())

    def present(self, presentation: Presentation) -> None:
        """Publish another presentation, whose assets are written already. Assets that it no longer names are deleted."""
        left = {asset.uri for asset in self._manifest.assets} - {asset.uri for asset in presentation.assets}
        left -= {"manifest.json", *(file.uri for file in self._manifest.files)}
        self._publish(replace(self._manifest, presentation=presentation), live=self._manifest.live)
        for uri in left:
            self._delete(uri)

    def finish(self) -> None:
        """Declare the reel complete. Raises `ReelError` if it has no group."""
        if not self._manifest.groups:
            raise ReelError(f"{self.path}: a reel without a group cannot be finished.")
        self._publish(self._manifest, live=False)

    def _check_header(self) -> None:
        file = self.path / "manifest.json"
        try:
            parse_manifest(replace(self._manifest, renditions=()).to_json().encode(), str(file))
        except ValueError as error:
            raise ReelError(f"{file}: would hold NaN or infinity. Look for it in the capture.") from error

    def _published(self) -> Manifest | None:
        file = self.path / "manifest.json"
        try:
            return parse_manifest(file.read_bytes(), str(file))
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ReelError(f"{file}: cannot be read ({error.strerror}). Make it readable or delete it.") from error

    def _intact(self) -> int:
        """How many groups, from the first on, have all their files as they were written."""
        broken = [entry.group for entry in self._manifest.files if not self._is_whole(entry)]
        return min(broken, default=len(self._manifest.groups))

    def _whole(self, presentation: Presentation) -> Presentation:
        """Without the pictures and the sound of which a file is damaged: they are made anew."""
        names = {name for name in ("poster", "thumbnails", "sound") if getattr(presentation, name) is not None}
        alone = {name: replace(EMPTY, **{name: getattr(presentation, name)}) for name in names}
        damaged = [name for name in names if not all(self._is_whole(asset) for asset in alone[name].assets)]
        return replace(presentation, **dict.fromkeys(damaged))

    def _is_whole(self, entry: FileEntry | Asset) -> bool:
        """Whether a file has the bytes that the manifest says."""
        path, digest = self.path / entry.uri, hashlib.sha256()
        try:
            if path.stat().st_size != entry.bytes:
                return False
            with open(path, "rb") as file:
                while part := file.read(1 << 20):
                    digest.update(part)
        except FileNotFoundError:
            return False
        except OSError as error:
            raise ReelError(f"{path}: cannot be read ({error.strerror}). Make it readable or delete it.") from error
        return digest.hexdigest() == entry.sha256

    def _check_next(self, group: int) -> None:
        if not 0 <= group <= len(self._manifest.groups):
            raise ReelError(
                f"{self.path}: group {group} cannot be added, the next one is {len(self._manifest.groups)}."
            )

    def _drop_from(self, group: int) -> None:
        """Take a group and all that follows out of the manifest first, and only then delete the files."""
        self._pending = None
        manifest = self._manifest
        dropped = [entry for entry in manifest.files if entry.group >= group]
        if not dropped:
            return
        layers = [entry for entry in manifest.layers if entry.group < group]
        self._publish(manifest.with_files(layers, list(manifest.groups[:group])))
        for entry in dropped:
            self._delete(entry.uri)

    def _publish(self, manifest: Manifest, live: bool = True) -> None:
        """Replace manifest.json; without groups there is none."""
        manifest = replace(manifest, live=live)
        if manifest.groups:
            write_atomically(self.path / "manifest.json", manifest.to_json().encode())
        else:
            self._delete("manifest.json")
        self._manifest = manifest

    def _write(self, uri: str, data: bytes, entry: FileEntry) -> FileEntry:
        write_atomically(self.path / uri, data)
        return replace(entry, bytes=len(data), sha256=hashlib.sha256(data).hexdigest())

    def _delete(self, uri: str) -> None:
        try:
            (self.path / uri).unlink(missing_ok=True)
        except OSError as error:
            raise ReelError(f"{self.path / uri}: cannot be deleted ({error.strerror}).") from error

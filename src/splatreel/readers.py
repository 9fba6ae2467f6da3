"""Parts of capture readers, for programs that read a layout of their own. `examples/capture_reader.py` shows their use.

A reader is a subclass of `FileCapture`. It makes a `Camera` of each pose, and names the frames: `ImageSequences` for numbered
images, `Videos` for a video of each camera. `Request` holds the size, the frames and the held-out cameras that the user asked for.
The result is a `Capture`, which `splatreel.reconstruct` and `splatreel.evaluate` take. Images that are in memory already need no
reader: `splatreel.capture_from_arrays` takes them.
"""

from splatreel.base.errors import CaptureError
from splatreel.capture.base import Capture, Request
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.image_sequences import ImageSequences, image_files
from splatreel.capture.sidecar import Sidecar, read_sidecar
from splatreel.capture.videos import Videos

__all__ = [
    "Capture",
    "CaptureError",
    "FileCapture",
    "ImageSequences",
    "Request",
    "Sidecar",
    "Videos",
    "image_files",
    "read_sidecar",
]

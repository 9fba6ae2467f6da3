"""Progress reports, for programs that use Splatreel. `base/progress.py` and `base/display.py` define them."""

from splatreel.base.display import console
from splatreel.base.progress import Cancellable, Progress, Silent

__all__ = ["Cancellable", "Progress", "Silent", "console"]

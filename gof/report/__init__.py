"""One self-contained HTML page that shows a reconstruction: pictures, animation, scores with controls, and costs."""

from gof.report.page import build_report
from gof.report.preview import Preview

__all__ = ["Preview", "build_report"]

"""The recorders of each method."""

from __future__ import annotations

from typing import Any


def recorder_types(fluid: bool) -> tuple[Any, Any, Any]:
    """Classes that record for Rerun, as USD and as a picture: of a flow, or of discrete elements."""
    if fluid:
        from .record_fluid import FlowPlotRecorder, FluidRerunRecorder, FluidUsdRecorder

        return FluidRerunRecorder, FluidUsdRecorder, FlowPlotRecorder
    from .record_plot import PlotRecorder
    from .record_rerun import RerunRecorder
    from .record_usd import UsdRecorder

    return RerunRecorder, UsdRecorder, PlotRecorder

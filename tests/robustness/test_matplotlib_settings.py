"""What a run draws does not depend on how its user has set matplotlib up."""

from __future__ import annotations

import os
from io import BytesIO
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import pytest

from hident.reports.style import looks, style, subplots

if TYPE_CHECKING:
    from tests.conftest import Lab

_MATPLOTLIBRC = """
backend: module://matplotlib_inline.backend_inline
interactive: True
text.usetex: True
savefig.dpi: 31
savefig.bbox: tight
font.family: fantasy
axes.facecolor: pink
axes.prop_cycle: cycler(color=['red'])
lines.linestyle: none
no such key: 1
figure.dpi: many
"""


def _png() -> bytes:
    file = BytesIO()
    with style():
        figure, axes = subplots(figsize=(3.0, 2.0))
        axes.plot([1.0, 2.0], [3.0, 5.0], label="$a_1$", **looks(["one"])["one"])
        axes.legend()
        figure.savefig(file, metadata={"Software": None})
    return file.getvalue()


@pytest.mark.parametrize(
    "settings",
    [
        {"text.usetex": True},
        {"savefig.dpi": 31, "savefig.bbox": "tight", "savefig.transparent": True},
        {"font.family": ["fantasy"], "axes.facecolor": "pink", "lines.linestyle": "none"},
        {"mathtext.fontset": "cm", "path.simplify": False, "legend.loc": "center"},
    ],
)
def test_settings_of_the_user_do_not_count(settings: Any) -> None:
    plain = _png()
    with mpl.rc_context(settings):
        assert _png() == plain
        assert mpl.rcParams[next(iter(settings))] == next(iter(settings.values()))


def test_a_run_writes_the_same_bytes_under_any_settings(lab: Lab) -> None:
    figure = {"kind": "curve", "x": "samples", "metric": "a a_1", "x_label": "N", "y_label": "$a_1$"}
    lab.configure(figures={"curve": figure})
    lab.run("-q", "--out", "plain")
    (lab.folder / "matplotlibrc").write_text(_MATPLOTLIBRC)
    (lab.folder / "taken").touch()
    environment = os.environ | {
        # That of every notebook, for the programs that it starts.
        "MPLBACKEND": "module://matplotlib_inline.backend_inline",
        "MPLCONFIGDIR": str(lab.folder / "taken"),
    }
    lab.run("-q", "--out", "strange", env=environment, fresh=True)
    plain, strange = ((lab.folder / out / "tiny/curve.png").read_bytes() for out in ("plain", "strange"))
    assert plain == strange

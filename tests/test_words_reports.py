"""The demonstrations of notebook 17."""

from __future__ import annotations

import pytest

from paper_artifact.errors import InputError
from paper_artifact.report import demos


def test_a_demonstration_grows_a_hole():
    own = demos.course("grow a hole")
    first, last = own.margins[0], own.margins[-1]
    assert own.reached is not None and first[0] < 0.5 < 1 < last[0] and last[1] < 0.5
    assert len(demos.strip_figure("grow a hole").axes) == demos.PICTURES
    table = demos.demo_table(["grow a hole"])
    assert table["words hold from step"].iloc[0] == own.reached and len(table) == demos.PICTURES
    with pytest.raises(InputError, match="no demonstration is called 'dig'; choose one of grow a hole"):
        demos.course("dig")

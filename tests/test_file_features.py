"""Every feature of mesh files is read right or refused by a true sentence, and docs/files.md says which."""

import pytest

from paper_artifact.files import REPOSITORY
from tests.file_features import FEATURES, outcome, table


@pytest.mark.parametrize("feature", FEATURES, ids=lambda feature: f"{feature.kind}: {feature.name}")
def test_a_feature_is_read_or_refused(feature, tmp_path):
    if "DracoPy" in feature.name:
        pytest.importorskip("DracoPy")
    outcome(feature, tmp_path)


def test_the_documents_table_is_this_one():
    pytest.importorskip("DracoPy")
    assert table() in (REPOSITORY / "docs" / "files.md").read_text(encoding="utf-8")

"""Notebook 15: Table S6, reconstruction methods by what their objective measures, with sources."""

from __future__ import annotations

import pandas as pd

from paper_artifact.report.kit.published import PUBLISHED, published

COLUMNS = {  # of the published table: heading
    "representation": "representation",
    "philosophy": "philosophy",
    "topology_in_objective": "topology in the objective?",
    "topology_from": "topology from",
}


def sources() -> pd.DataFrame:
    """Return the methods' sources: method, key (in the paper's bibliography), title, year, venue, link, what
    is optimised, checked against what ("abstract", or "objective": also the loss itself in the paper's body,
    on its authors' page or in their code). Texts."""
    return pd.read_csv(PUBLISHED / "literature.csv", dtype=str, keep_default_na=False)


def table_s6() -> pd.DataFrame:
    """Return Table S6 as the paper prints it, a row per method and source, with year, venue, link and what
    the source optimises; the paper's own two rows have no source."""
    joined = published("S6").merge(sources(), on="method", how="left", sort=False).fillna("")
    table = joined.set_index("method")[[*COLUMNS, "optimises", "year", "venue", "link", "checked"]]
    return table.rename(columns=COLUMNS | {"optimises": "optimises (ours)"})


def philosophy_table() -> pd.DataFrame:
    """Return how many methods of Table S6 the paper puts under which philosophy, and what it says of the
    topology in their objective."""
    table = published("S6")
    return pd.crosstab(table["philosophy"], table["topology_in_objective"])

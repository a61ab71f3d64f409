"""Old name of `report.kit.figures`, until every caller has moved."""

from paper_artifact.report.kit.figures import *

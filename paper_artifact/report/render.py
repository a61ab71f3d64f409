"""Old name of `report.kit.render`, until every caller has moved."""

from paper_artifact.report.kit.render import *

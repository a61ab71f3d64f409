"""Old name of `report.kit.records`, until every caller has moved."""

from paper_artifact.report.kit.records import *

"""Old name of `report.kit.published`, until every caller has moved."""

from paper_artifact.report.kit.published import *

"""What the reports share: records and frames of them, wording, figures, pictures of surfaces; no
notebook's own tables."""

"""Tables and figures that the notebooks show: the published values, ours beside them."""

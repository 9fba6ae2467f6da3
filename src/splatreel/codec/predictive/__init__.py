"""The predictive codec: integers of points, predicted from neighbors and entropy coded."""

"""The report page: one HTML file about a run and its evaluation."""

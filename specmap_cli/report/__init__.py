"""The report on a map: one HTML page that loads nothing. Templates, styles, scripts beside."""

"""A comparison as one HTML page and its figures: contents, data for the page's script, the page."""

"""From logs to the parameters of table and specimen, with their uncertainty."""

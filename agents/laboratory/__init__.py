"""The laboratory's loop: logs of tests, identification, posterior, forecast, sequence of shakes."""

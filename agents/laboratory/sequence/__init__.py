"""A sequence of shakes of rising amplitude: plan, forecast, shake, update."""

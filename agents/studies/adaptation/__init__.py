"""How fast controllers learn a drawn plant within an episode, beside one that is told it."""

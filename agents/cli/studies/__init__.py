"""Commands on studies: reproduction of the paper, transients, components, noise of gradients."""

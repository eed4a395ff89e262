"""Commands of the studies: the paper anew, transients, components, noise of gradients."""

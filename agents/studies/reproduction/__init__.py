"""Tables and figures of Gavin and Hoagg (2009)."""

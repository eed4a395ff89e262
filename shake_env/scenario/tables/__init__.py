"""Shake tables by name, each a file of facts with their sources."""

from shake_env.scenario.tables.table import DEFAULT_TABLE, TABLE_NAMES, Table, named_table

__all__ = ["DEFAULT_TABLE", "TABLE_NAMES", "Table", "named_table"]

"""Pages, tables, figures and model cards."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "comparison_tables": (
            "print_tables",
            "write_files",
        ),
        "csv_file": ("write_csv",),
        "evaluation_tables": ("put_tables",),
        "markdown_blocks": ("put_block",),
        "model_card": (
            "robustness_of",
            "write_card",
        ),
        "report.contents": (
            "HistoryCollector",
            "make_report",
        ),
        "report.page": ("write_report",),
        "robustness_figures": ("draw_robustness",),
        "robustness_tables": (
            "read_robustness",
            "robustness_section",
            "write_robustness",
        ),
        "terminal": (
            "OutputConsole",
            "print_markdown",
            "print_table",
        ),
        "video": ("write_video",),
    },
)

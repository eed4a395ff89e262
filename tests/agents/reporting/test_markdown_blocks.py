"""What commands write into pages of the documentation."""

import pytest

from agents.reporting.markdown_blocks import has_place, put_block
from shake_env.errors import ParameterError

PAGE = """before
<!-- table one -->
old
<!-- end one -->
between
<!-- two -->
<!-- end two -->
after
"""


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(PAGE)
    return path


def test_what_is_put_replaces_what_stood_there_and_nothing_else(page):
    for _ in range(2):
        put_block(page, "table one", "\n| a |\n", end="one")
    assert page.read_text() == PAGE.replace("old\n", "\n| a |\n\n")
    put_block(page, "two", "text")
    assert page.read_text().endswith("between\n<!-- two -->\n\ntext\n\n<!-- end two -->\nafter\n")
    put_block(page, "table one", "", end="one")
    put_block(page, "two", "")
    assert page.read_text() == PAGE.replace("old\n", "")


def test_a_page_without_the_place_is_refused_and_left_alone(page):
    assert has_place(page, "two") and not has_place(page, "three")
    assert not has_place(page.with_name("none.md"), "two")
    for place, end in (("three", None), ("two", "three"), ("table one", None)):
        with pytest.raises(ParameterError, match=f"put the lines <!-- {place} --> and <!-- end"):
            put_block(page, place, "text", end)
    with pytest.raises(ParameterError, match=r"none\.md.*no such file"):
        put_block(page.with_name("none.md"), "two", "text")
    assert page.read_text() == PAGE

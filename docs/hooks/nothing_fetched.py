"""No page asks for anything from the network: the one script that the offline theme takes from there is our own."""

from __future__ import annotations

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.pages import Page
from mkdocs.utils import get_relative_url

THEIRS = "https://unpkg.com/iframe-worker/shim"
OURS = "theme/search_in_files.js"


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Take the script for the search in pages opened as files from the site itself."""
    return output.replace(THEIRS, get_relative_url(OURS, page.url))


def on_post_template(output_content: str, template_name: str, config: MkDocsConfig) -> str:
    """The same in the page for addresses that do not exist, which stands at the top of the site."""
    return output_content.replace(THEIRS, OURS)

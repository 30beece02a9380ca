"""Templates of pages, all read by the same rules: what is missing is an error, blocks leave no blank lines."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template


def page_template(beside: str, name: str, html: bool = True, **filters: Callable[..., Any]) -> Template:
    """A template in the folder of a module.

    Args:
        beside: file of the module.
        name: of the template's file.
        html: whether texts are escaped for HTML; else whoever puts them in sees to that.
        filters: by the name that the template calls them.
    """
    environment = Environment(
        loader=FileSystemLoader(Path(beside).parent),
        autoescape=html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(filters)
    return environment.get_template(name)

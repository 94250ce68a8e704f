"""The table of materials that `carom explain` and `carom inspect` print."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

COLOUR = "colour by material"  # bodies have it where `colour_by` is "material"; often they show groups


def materials_table(materials: list[dict[str, Any]]) -> Table:
    """Show the coefficients of each kind of contact, given `ShownMaterials.described`."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for header in ("material", "bodies", COLOUR, "on", "e", "μs", "μk"):
        table.add_column(header, justify="left" if header in ("material", COLOUR, "on") else "right")
    listed: set[str] = set()
    for material in materials:
        first = (material["name"], str(material["bodies"]), material["colour"])
        for other, coefficients in material["contacts"].items():
            if other in listed:  # the same contact stands in the rows of the other material
                continue
            table.add_row(*first, other, *(f"{value:.4g}" for value in coefficients.values()))
            first = ("", "", "")
        listed.add(material["name"])
    return table

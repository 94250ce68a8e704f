"""Modules import in one direction: whoever reads one needs only those below it."""

from graphlib import TopologicalSorter

import grimp


def test_no_modules_import_each_other_in_a_circle() -> None:
    # imports within functions count, and imports for type checkers
    graph = grimp.build_graph("carom", exclude_type_checking_imports=False)
    TopologicalSorter({module: graph.find_modules_directly_imported_by(module) for module in graph.modules}).prepare()

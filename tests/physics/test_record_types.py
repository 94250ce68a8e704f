"""Records of kernels: their fields have types, so that a misspelt one is an error of mypy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mypy import api

from carom.arrays import RecordArray, dtype_of
from carom.physics.contact.constraints import CONTACT, ROLLING_CONTACT
from carom.physics.contact.records import ContactGeometry, ContactRecord, RollingContactRecord

SNIPPET = """
from carom.physics.contact.constraints import ConstraintSystem

def kernel(system: ConstraintSystem) -> None:
    contact = system.contacts[0]
    contact.normal_impulse = contact.velocity_{name}
"""


def test_a_field_has_the_type_that_its_class_states() -> None:
    kind = np.dtype(dtype_of(ContactRecord))
    assert list(kind.names or ()) == [*ContactGeometry.__annotations__, *ContactRecord.__annotations__]
    assert {kind[name] for name in kind.names or ()} == {np.dtype(np.float64)}


def test_fields_of_a_law_with_torques_follow_those_of_all_contacts() -> None:
    names = CONTACT.names or ()
    assert ROLLING_CONTACT.names is not None
    assert ROLLING_CONTACT.names[: len(names)] == names
    rolling: RecordArray[RollingContactRecord] = np.zeros(1, ROLLING_CONTACT)
    contacts: RecordArray[ContactRecord] = rolling  # kernels for contacts accept them
    assert len(contacts) == 1


@pytest.mark.nightly
@pytest.mark.slow
def test_a_misspelt_field_is_an_error_of_mypy(tmp_path: Path) -> None:
    for name, errors in (("bias", 0), ("bais", 1)):
        module = tmp_path / f"of_{name}.py"
        module.write_text(SNIPPET.format(name=name))
        report, _, status = api.run(["--strict", str(module)])
        assert (status, report.count(": error:")) == (errors, errors), report
        assert ('has no attribute "velocity_bais"' in report) == bool(errors)

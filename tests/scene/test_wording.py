"""Numbers of things, in words."""

from carom.scene.wording import counted


def test_one_is_singular_and_all_other_numbers_are_plural() -> None:
    assert [counted(count, "body") for count in (0, 1, 2)] == ["0 bodies", "1 body", "2 bodies"]
    assert counted(1, "contact-step") == "1 contact-step" and counted(3, "contact-step") == "3 contact-steps"

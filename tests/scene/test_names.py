from carom.scene.wording import Names, bodies_called, body_called, body_key, in_series

NAMES = Names(["ball", "body 1", ""], ["floor", "plane 1", "wall at -x"])


def test_a_body_is_called_by_its_number_and_the_name_that_somebody_gave_it() -> None:
    assert [NAMES.of(end) for end in range(3)] == ['body 0 "ball"', "body 1", "body 2"]
    assert (body_key(0, "ball"), body_key(1, "body 1")) == ('body.0 ("ball")', "body.1")


def test_a_body_that_has_the_number_of_another_as_its_name_keeps_its_own() -> None:
    assert body_called(3, "body 7") == 'body 3 "body 7"'


def test_planes_and_walls_are_called_by_their_names() -> None:
    assert [NAMES.of(end) for end in range(3, 6)] == ["floor", "plane 1", "wall at -x"]
    assert NAMES.pair((0, 3)) == 'body 0 "ball" and floor'


def test_a_plane_whose_name_is_lost_is_called_by_its_number() -> None:
    assert NAMES.of(6) == "plane 3"


def test_many_bodies_are_listed_up_to_eight() -> None:
    assert bodies_called([0, 1], NAMES.bodies) == 'body 0 "ball" and body 1'
    assert in_series(["one"]) == "one"
    assert in_series([str(k) for k in range(11)]) == "0, 1, 2, 3, 4, 5, 6, 7 and 3 more"

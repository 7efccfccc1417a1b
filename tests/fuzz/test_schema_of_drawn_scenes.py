"""Whatever scene pmpm takes, an editor that knows the JSON schema takes it, too."""

import drawn_scenes as drawn
import jsonschema
from hypothesis import HealthCheck, Phase, given, settings

from pmpm.scene.json_schema import scene_schema

VALIDATOR = jsonschema.Draft7Validator(scene_schema())
COUNT = 200


def test_scenes_that_are_read_fit_the_schema():
    seen = []

    @settings(
        max_examples=COUNT,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(drawn.scenes())
    def fits(table):
        seen.append(table)
        assert [error.message for error in VALIDATOR.iter_errors(table)] == []

    fits()
    assert len(seen) == COUNT
    assert len({table["materials"][name]["model"] for table in seen for name in table["materials"]}) > 5

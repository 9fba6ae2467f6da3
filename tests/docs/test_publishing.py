"""The settings in docs/publishing.md are those of the tests with a bucket and a browser."""

import json
import re
from pathlib import Path

from splatreel.codec.publish import headers_of, is_published_name
from tests.buckets import CORS, readable_by_all

TEXT = (Path(__file__).parents[2] / "docs" / "publishing.md").read_text(encoding="utf-8")


def test_the_permissions_are_those_that_are_tested() -> None:
    policy, cors, google = map(json.loads, re.findall(r"```json\n(.*?)```", TEXT, re.DOTALL))
    assert policy == readable_by_all("BUCKET")
    assert cors == CORS
    (rule,) = CORS["CORSRules"]
    assert google[0]["origin"] == rule["AllowedOrigins"]
    assert google[0]["method"] == rule["AllowedMethods"]


def test_names_and_headers_are_those_that_are_set() -> None:
    (name,) = re.findall(r"groups/\S+\.safetensors", TEXT)
    assert is_published_name(name)
    assert f"`Cache-Control: {headers_of(name).caching}`" in TEXT
    assert f"`{headers_of('manifest.json').caching}`" in TEXT

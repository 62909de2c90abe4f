import json

from twinline.api.openapi import FILE, document


def test_the_committed_description_is_that_of_the_api() -> None:
    message = "the API has changed: run `python -m twinline.api.openapi` and look at the difference"
    assert FILE.read_text(encoding="utf-8") == document(), message


def test_every_reference_in_it_leads_somewhere() -> None:
    text = document()
    schemas = json.loads(text)["components"]["schemas"]
    references = {part.split('"')[0] for part in text.split("#/components/schemas/")[1:]}
    assert references <= set(schemas)
    assert {"SnapshotOut", "ChangeOut", "JobOut"} <= set(schemas)

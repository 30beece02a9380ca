"""Records of which there are kinds: a table is read as the one that its key `kind` names."""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

from pydantic import ModelWrapValidatorHandler, ValidationError, model_validator
from pydantic_core import PydanticKnownError

from beamdesign.records import Record, under_tag


class Kinded(Record):
    """A record of which there are kinds, each told by its field `kind`, whose default is its name.

    A field of an abstract one takes any known kind; of a class between, only those that derive from it.
    """

    kind: str
    known: ClassVar[Mapping[str, type[Any]]]
    """All kinds by their names."""
    where_none_is_stated: ClassVar[str] = ""
    """The kind of a table that states none; empty where it has to."""

    @classmethod
    def variants(cls) -> list[type[Record]]:
        """Itself where it is a kind, else the known kinds that derive from it."""
        known = cls.known.values()
        return [cls] if cls in known else [kind for kind in known if issubclass(kind, cls)]

    @model_validator(mode="wrap")
    @classmethod
    def _by_kind(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        kinds = {str(each.model_fields["kind"].default): each for each in cls.variants()}
        if cls in kinds.values() or isinstance(data, cls) or not isinstance(data, dict):
            return handler(data)
        if "kind" not in data and not cls.where_none_is_stated:
            raise PydanticKnownError("union_tag_not_found", {"discriminator": "'kind'"})
        if not isinstance(tag := data.get("kind", cls.where_none_is_stated), str) or tag not in kinds:
            known = ", ".join(repr(name) for name in kinds)
            raise PydanticKnownError(
                "union_tag_invalid", {"discriminator": "'kind'", "tag": str(tag), "expected_tags": known}
            )
        try:
            return kinds[tag].model_validate(data)  # type: ignore[return-value]
        except ValidationError as error:
            raise under_tag(error, tag) from None

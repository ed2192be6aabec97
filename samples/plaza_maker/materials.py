"""The materials by name."""

from samples.plaza_maker import masonry, street

MATERIALS = {
    function.__name__: function
    for function in (
        masonry.ashlar,
        masonry.marble,
        masonry.fluted,
        masonry.brick,
        masonry.tiles,
        masonry.dome,
        masonry.drum,
        masonry.glass,
        masonry.bronze_door,
        masonry.relief,
        masonry.inscription,
        masonry.clock,
        street.paving,
        street.foliage,
        street.bark,
        street.water,
        street.metal,
        street.lamp,
        street.house,
        street.hill,
        street.skin,
        street.cloth,
        street.paint,
        street.tyre,
    )
}

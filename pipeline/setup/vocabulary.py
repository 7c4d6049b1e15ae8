"""Words by which logs name quantities, places of measurement, and what is no measurement."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping


def _spelled(text: str) -> set[str]:
    """Words of a text as they are spelled with and without their marks: ö as oe and as o."""
    two = {"ö": "oe", "ä": "ae", "ü": "ue", "ł": "l", "ø": "o"}
    words = text.split()
    found = set(words)
    for word in words:
        found.add("".join(two.get(letter, letter) for letter in word))
        parts = unicodedata.normalize("NFD", word)
        found.add("".join(one for one in parts if not unicodedata.combining(one)))
    return found


# As loggers are labelled in English, German, Dutch, Swedish, Danish, Norwegian, Spanish, French,
# Portuguese, Italian and Polish, and letters of ISA 5.1; by quantity, the first that fits counts.
WORDS: Mapping[str, set[str]] = {
    "temperature": _spelled(
        "temp temperature temperatur oiltemp öltemperatur oljetemp toil temperatura température "
        "töl tt tit temperatuur olietemperatuur"
    ),
    "pressure": _spelled(
        "press pressure druck tryck dp deltap port anschluss pdiff differenzdruck hochdruck "
        "niederdruck speisedruck gehäusedruck druckdifferenz tryckskillnad differenstryck högtryck "
        "lågtryck hustryck matningstryck presión pression pt pit pdt pdit dpt pressione pressão "
        "ciśnienie druk drukverschil tryk trykk"
    ),
    "speed": _spelled(
        "speed rpm drehzahl varvtal revs rotation omega nmot velocidad vitesse régime st sit "
        "velocità velocidade giri rotação obroty prędkość toerental turtall omdrejningstal"
    ),
    "flow": _spelled(
        "flow flowrate leak leakage drain durchfluss volumenstrom flöde leck leckage lecköl "
        "leckstrom leckölstrom läckage läckflöde leckölmenge qleak qleck caudal fuga débit fuite "
        "ft fit portata drenaggio trafilamento vazão dreno vazamento przepływ przeciek wyciek "
        "debiet lekdebiet lekolie lekkasje lækage"
    ),
}
ALL_WORDS = {word for known in WORDS.values() for word in known}
# Ends of words that German and Swedish put together.
ENDINGS: Mapping[str, str] = {
    end: quantity
    for quantity, ends in {
        "temperature": "temperatur temperatuur",
        "pressure": "druck tryck druk trykk tryk",
        "speed": "drehzahl varvtal toerental turtall",
        "flow": "durchfluss volumenstrom debiet",
    }.items()
    for end in ends.split()
}
LETTERS = {"p": "pressure", "t": "temperature", "n": "speed", "q": "flow"}
LONGEST_WITH_A_LETTER = 4
# Of another machine or place, or no measurement.
STRANGERS: Mapping[str, set[str]] = {
    "temperature": _spelled(
        "ambient room air water winding umgebung luft wasser tank ambiente ambiante omgivning "
        "vatten agua eau bearing lager água acqua aria avvolgimento enrolamento mancal cuscinetto "
        "serbatoio otoczenie otoczenia łożysko łożyska uzwojenie powietrze omgeving lucht "
        "wikkeling omgivelse vann vand zbiornik"
    ),
    "pressure": {"water", "air", "luft"},
    "speed": _spelled(
        "pump fan engine diesel wind pumpe lüfter bomba pompe pompa pompy pomp ventilatore "
        "wentylator ventilator"
    ),
    "flow": _spelled(
        "pump pumpe flush flushing spülung charge feed boost speise bomba pompe gavage matning "
        "water wasser pompa pompy pomp mandata lavaggio lavagem płukanie spoelen"
    ),
}
NO_MEASUREMENT = {"setpoint", "sp", "target", "limit", "soll", "max", "demand", "reference"}
DIFFERENCE = _spelled(
    "dp deltap delta diff difference differential differenzdruck pdiff druckdifferenz "
    "tryckskillnad differenstryck diferencial différentielle pdt pdit dpt differenziale różnica "
    "różnicowe verschil drukverschil verschildruk differanse forskel"
)
PRESSURES = (
    ("pressure_difference", DIFFERENCE),
    (
        "charge_pressure",
        _spelled(
            "charge feed boost speise speisedruck matning matningstryck carga gavage voeding "
            "voedingsdruk sovralimentazione"
        ),
    ),
    (
        "case_pressure",
        _spelled(
            "case housing gehäuse gehäusedruck drain hus hustryck carcasa carter carcaça carcassa "
            "obudowa huis huisdruk"
        ),
    ),
    (
        "low_port_pressure",
        _spelled(
            "low lp niederdruck nd låg return lågtryck bp baja basse baixa bassa retorno ritorno "
            "retour lagedruk niskie powrót b 2"
        ),
    ),
    (
        "high_port_pressure",
        _spelled(
            "high hp hochdruck hd hög supply högtryck alta haute mandata hogedruk persdruk wysokie "
            "a 1"
        ),
    ),
)
PORT_PRESSURES = ("high_port_pressure", "low_port_pressure")
PORTS = {"a", "b", "1", "2"}
BESIDE_A_PORT = {"p", *WORDS["pressure"]} - DIFFERENCE
PREFERRED: Mapping[str, set[str]] = {
    "leakage_flow": WORDS["flow"]
    - _spelled(
        "flow flowrate durchfluss volumenstrom flöde caudal débit ft portata vazão przepływ debiet"
    ),
    "oil_temperature": _spelled(
        "oil öl olja drain case leck oiltemp öltemperatur aceite huile toil oljetemperatur "
        "lecköltemperatur olio óleo oleju olie olietemperatuur"
    ),
    "speed": {"motor", "shaft", "actual", "ist"},
}

"""Wi-Fi of an ESP32, which runs this file first."""

import network
import settings

station = network.WLAN(network.STA_IF)
station.active(True)
station.connect(*settings.WIFI)

"""Square markers: dictionaries and their codes, printable sheets, blur, and the bound on measuring them."""

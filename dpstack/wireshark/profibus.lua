-- dpstack wireshark: this file is installed and removed by `dpstack wireshark`
--
-- PROFIBUS-DP for Wireshark: link layer (FDL), DP-V0, DP-V1, and the course of the bus.
--
-- It explains packets of link type 147 (USER0) as `dpstack decode` does: the fields below `profibus` have the names of
-- its JSON objects in lower case, those of a data unit stand below `profibus.dp`. One packet is one transmission.
-- Lua 5.2 (Wireshark up to 4.2) to 5.4 (from 4.4 on): no operators for bits, no library `bit`.
--
-- A table by master and slave: `tshark -q -o profibus.table:TRUE -r FILE`; in Wireshark: Tools, PROFIBUS.

local profibus = Proto("profibus", "PROFIBUS-DP")

profibus.prefs.baud = Pref.uint("Baud rate in bit/s", 0, "For response times, where the file does not name it; 0: as the file says")
profibus.prefs.names = Pref.string("Names of the plant", "", "A file of `dpstack wireshark names CONFIG`")
profibus.prefs.table = Pref.bool("Table by master and slave", false, "tshark prints it at the end of the file")

-- --- numbers ---------------------------------------------------------------------------------------------------------

local POWERS = { [0] = 1, 2, 4, 8, 16, 32, 64, 128, 256 }

-- bits of a number, from bit `low` on
local function bits(value, low, count)
    return math.floor(value / POWERS[low]) % POWERS[count]
end

local function bit(value, number)
    return math.floor(value / POWERS[number]) % 2 == 1
end

-- the octet at `at` (from 1) of a string
local function octet(octets, at)
    return string.byte(octets, at)
end

local function word(octets, at)
    return string.byte(octets, at) * 256 + string.byte(octets, at + 1)
end

local function set(...)
    local found = {}
    for _, value in ipairs({ ... }) do
        found[value] = true
    end
    return found
end

-- raised for the octets of a data unit that cannot be read
local function refuse(...)
    error({ pdu = string.format(...) }, 0)
end

local function octets_text(count)
    return string.format(count == 1 and "%d octet" or "%d octets", count)
end

-- --- the link layer: docs/reference/protocol.md of dpstack, "Telegrams" --------------------------------------------------------

local SD1, SD2, SD3, SD4, SC, ED = 0x10, 0x68, 0xA2, 0xDC, 0xE5, 0x16
local KINDS = { [SD1] = "SD1", [SD2] = "SD2", [SD3] = "SD3", [SD4] = "SD4", [SC] = "SC" }
local LENGTHS = { [SD1] = 6, [SD3] = 14, [SD4] = 3, [SC] = 1 }
local BROADCAST = 127

local BAD_START = "no start octet (10, 68, A2, DC, E5)"
local LE_MISMATCH = "LE and LEr differ"
local LE_RANGE = "LE outside of 3..249"
local BAD_SECOND_SD = "the second start octet is not 68"
local BAD_ED = "the end octet is not 16"
local BAD_FCS = "wrong check sequence (FCS)"
local BAD_ADDRESS = "an address above 127"
local BAD_EXTENSION = "address extensions that are not whole"
local BAD_FC = "a function code that does not exist"

local function check_sum(octets, first, last)
    local sum = 0
    for at = first, last do
        sum = sum + octet(octets, at)
    end
    return sum % 256
end

-- A telegram: kind, da, sa, fc, dsap, ssap, dseg, sseg, data (a string), and for the tree: da_at, data_at, end_at
-- (octets from 0; end_at is that of the FCS).
local function content(kind, octets, first, last)
    local da, sa, fc = octet(octets, first), octet(octets, first + 1), octet(octets, first + 2)
    if fc > 0x7F and not (bits(fc, 6, 2) == 3 and bits(fc, 0, 4) == 0) then
        return nil, BAD_FC
    end
    if sa % 128 == BROADCAST then
        return nil, BAD_ADDRESS
    end
    local at = first + 3
    local found = {}
    for number, address in ipairs({ da, sa }) do
        local more = address >= 128
        while more do
            if at > last then
                return nil, BAD_EXTENSION
            end
            local value = octet(octets, at)
            at = at + 1
            more = value >= 128
            local name = (bit(value, 6) and "seg" or "sap") .. number
            if found[name] then
                return nil, BAD_EXTENSION
            end
            found[name] = value % 64
            found[name .. "_at"] = at - 2
        end
    end
    return {
        kind = kind, da = da % 128, sa = sa % 128, fc = fc, request = bit(fc, 6), func = fc % 16,
        dsap = found.sap1, ssap = found.sap2, dseg = found.seg1, sseg = found.seg2,
        dsap_at = found.sap1_at, ssap_at = found.sap2_at, dseg_at = found.seg1_at, sseg_at = found.seg2_at,
        data = string.sub(octets, at, last), da_at = first - 1, data_at = at - 1, end_at = last,
    }
end

local function parse_sd2(octets)
    local size = #octets
    if size > 1 then
        local le = octet(octets, 2)
        if le < 3 or le > 249 then
            return nil, LE_RANGE
        elseif size > 2 and octet(octets, 3) ~= le then
            return nil, LE_MISMATCH
        elseif size > 3 and octet(octets, 4) ~= SD2 then
            return nil, BAD_SECOND_SD
        end
        if size >= 9 and size >= le + 6 then
            if octet(octets, le + 6) ~= ED then
                return nil, BAD_ED
            elseif check_sum(octets, 5, le + 4) ~= octet(octets, le + 5) then
                return nil, BAD_FCS
            end
            return content("SD2", octets, 5, le + 4)
        end
    end
    return nil
end

local function parse_sd1(octets)
    local size = #octets
    if (size > 1 and octet(octets, 2) > 127) or (size > 2 and octet(octets, 3) > 126) then
        return nil, BAD_ADDRESS
    elseif size < 6 then
        return nil
    elseif octet(octets, 6) ~= ED then
        return nil, BAD_ED
    elseif check_sum(octets, 2, 4) ~= octet(octets, 5) then
        return nil, BAD_FCS
    end
    return content("SD1", octets, 2, 4)
end

local function parse_sd3(octets)
    if #octets < 14 then
        return nil
    elseif octet(octets, 14) ~= ED then
        return nil, BAD_ED
    elseif check_sum(octets, 2, 12) ~= octet(octets, 13) then
        return nil, BAD_FCS
    end
    return content("SD3", octets, 2, 12)
end

local function parse_token(octets)
    local size = #octets
    if (size > 1 and octet(octets, 2) > 126) or (size > 2 and octet(octets, 3) > 126) then
        return nil, BAD_ADDRESS
    elseif size < 3 then
        return nil
    end
    return { kind = "SD4", da = octet(octets, 2), sa = octet(octets, 3), data = "", da_at = 1, data_at = 3, end_at = 3 }
end

-- The number of octets that the telegram claims to have; of an SD2 telegram the larger one of LE and its repetition.
local function claimed(octets)
    if octet(octets, 1) ~= SD2 then
        return LENGTHS[octet(octets, 1)] or 1
    elseif #octets < 2 then
        return 2
    end
    local le = octet(octets, 2)
    if #octets > 2 and octet(octets, 3) > le then
        le = octet(octets, 3)
    end
    return math.min(math.max(le, 3), 249) + 6
end

-- The octet that shows a flaw, counted from 1.
local function place_of(flaw, octets)
    local size = claimed(octets)
    if flaw == LE_MISMATCH then
        return string.format(": octets 2 and 3 are %02x and %02x", octet(octets, 2), octet(octets, 3))
    elseif flaw == LE_RANGE then
        return string.format(": octet 2 is %02x", octet(octets, 2))
    elseif flaw == BAD_SECOND_SD then
        return string.format(": octet 4 is %02x", octet(octets, 4))
    elseif flaw == BAD_ED then
        return string.format(": octet %d is %02x", size, octet(octets, size))
    elseif flaw == BAD_FCS then
        local first = octet(octets, 1) == SD2 and 5 or 2
        return string.format(": octet %d is %02x, the sum is %02x", size - 1, octet(octets, size - 1),
            check_sum(octets, first, size - 2))
    elseif flaw == BAD_START then
        return string.format(": octet 1 is %02x", octet(octets, 1))
    end
    return ""
end

-- The telegram that `octets` are from the first to the last; nil and the reason where they are none.
local function decode(octets)
    local size = #octets
    if size == 0 then
        return nil, "no octets"
    end
    local start = octet(octets, 1)
    local telegram, flaw
    if start == SD2 then
        telegram, flaw = parse_sd2(octets)
    elseif start == SC then
        telegram = { kind = "SC", data = "", data_at = 1, end_at = 1 }
    elseif start == SD1 then
        telegram, flaw = parse_sd1(octets)
    elseif start == SD4 then
        telegram, flaw = parse_token(octets)
    elseif start == SD3 then
        telegram, flaw = parse_sd3(octets)
    else
        flaw = BAD_START
    end
    if flaw then
        return nil, "no telegram: " .. flaw .. place_of(flaw, octets)
    elseif not telegram and size == 1 then
        return nil, "no telegram: cut off"
    elseif not telegram then
        return nil, string.format("no telegram: cut off after %s of %d", octets_text(size), claimed(octets))
    elseif claimed(octets) ~= size then
        return nil, string.format("a telegram with other octets after it, from octet %d on", claimed(octets) + 1)
    end
    return telegram
end

-- --- names -----------------------------------------------------------------------------------------------------------

local REQUESTS = {
    [0] = "TIME_EVENT", [3] = "SDA_LOW", [4] = "SDN_LOW", [5] = "SDA_HIGH", [6] = "SDN_HIGH", [7] = "MSRD",
    [9] = "FDL_STATUS", [12] = "SRD_LOW", [13] = "SRD_HIGH", [14] = "IDENT", [15] = "LSAP_STATUS",
}
local RESPONSES = {
    [0] = "OK", [1] = "UE", [2] = "RR", [3] = "RS", [8] = "DL", [9] = "NR", [10] = "DH", [12] = "RDL", [13] = "RDH",
}
local SHORT_NAMES = {
    [3] = "SDA low", [4] = "SDN low", [5] = "SDA high", [6] = "SDN high", [12] = "SRD low", [13] = "SRD high",
}
local STATION_TYPES = { [0] = "slave", "master not ready", "master ready", "master in ring" }
-- services that have a function code of their own
local BY_FUNCTION = { [0] = "Time_Event", [7] = "MSRD", [9] = "FDL_Status", [14] = "Ident", [15] = "LSAP_Status" }
local BY_SAP = {
    [49] = "MS2 resource manager", [50] = "MS1 alarm", [51] = "MS1", [53] = "Ext_User_Prm", [54] = "master-master",
    [55] = "Set_Slave_Add", [56] = "RD_Inp", [57] = "RD_Outp", [58] = "Global_Control", [59] = "Get_Cfg",
    [60] = "Slave_Diag", [61] = "Set_Prm", [62] = "Chk_Cfg",
}
-- polls of the GAP: as a rule nobody has that address
local FDL_STATUS = 9
-- answers without a complaint: OK, DL, DH
local GOOD = set(0, 8, 10)
-- requests with a frame count, and those that nobody answers
local COUNTED = set(3, 5, 7, 12, 13)
local UNANSWERED = set(0, 4, 6)

local function service_by_saps(slave, master)
    if slave == nil then
        return master == nil and "Data_Exchange" or "SAP none/" .. master
    end
    local named = BY_SAP[slave]
    if not named and slave < 49 and master == 50 then
        return "MS2 connection " .. slave
    end
    return named or "SAP " .. slave
end

local function service_of(telegram)
    if telegram.kind == "SC" then
        return "SC"
    elseif telegram.kind == "SD4" then
        return "token"
    elseif telegram.request then
        local named = BY_FUNCTION[telegram.func]
        if named then
            return telegram.fc >= 128 and "Clock_Value" or named
        end
        return service_by_saps(telegram.dsap, telegram.ssap)
    elseif telegram.dsap == nil and telegram.ssap == nil and telegram.data == "" then
        return "acknowledgement"
    end
    return service_by_saps(telegram.ssap, telegram.dsap)
end

-- --- layouts: names and lengths of the fields of a PDU, for messages --------------------------------------------------

-- fields: name, bits, name, bits ...; `open`: more octets may follow
local function layout(name, open, ...)
    local found = { name = name, open = open, ends = {}, size = 0 }
    local fields, total = { ... }, 0
    for at = 1, #fields, 2 do
        total = total + fields[at + 1]
        found.ends[#found.ends + 1] = { fields[at], total }
    end
    found.size = math.floor(total / 8)
    return found
end

local function check(form, octets)
    local count = #octets
    if count < form.size then
        for _, field in ipairs(form.ends) do
            if field[2] > 8 * count then
                refuse("%s ends after %s: octet %d (%s) is missing", form.name, octets_text(count), count + 1, field[1])
            end
        end
    elseif count > form.size and not form.open then
        refuse("%s has %s, octet %d is the last one", form.name, octets_text(count), form.size)
    end
end

-- --- what a data unit holds: lists of nodes --------------------------------------------------------------------------
-- A node: { key, value, at, size } with octets from 0 of the data unit; value nil: the octets themselves.
-- A group: { title = text, at = , size = , nodes }.

local function node(nodes, key, value, at, size)
    nodes[#nodes + 1] = { key = key, value = value, at = at, size = size or 1 }
end

local function node_octets(nodes, key, at, size)
    if size > 0 then
        nodes[#nodes + 1] = { key = key, at = at, size = size }
    end
end

local function group(nodes, title, at, size)
    local found = { title = title, at = at, size = size }
    nodes[#nodes + 1] = found
    return found
end

local function node_groups(nodes, key, mask, at)
    for number = 0, 7 do
        if bit(mask, number) then
            node(nodes, key, number + 1, at)
        end
    end
end

-- --- Set_Prm ---------------------------------------------------------------------------------------------------------

local SET_PRM = layout("Set_Prm", true, "lock", 1, "unlock", 1, "sync", 1, "freeze", 1, "wd_on", 1, "reserved", 3,
    "wd_fact_1", 8, "wd_fact_2", 8, "min_tsdr", 8, "ident", 16, "group_ident", 8)
local MAX_USER_PRM = 237
local ALARM_KINDS = {
    { 7, "Pull_Plug_Alarm" }, { 6, "Process_Alarm" }, { 5, "Diagnostic_Alarm" }, { 4, "Manufacturer_Specific_Alarm" },
    { 3, "Status_Alarm" }, { 2, "Update_Alarm" },
}
local ALARM_LIMITS = { [0] = "one of each type", "2", "4", "8", "12", "16", "24", "32" }
local BLOCK_NAMES = {
    [2] = "prm_cmd", [3] = "dxb_links", [4] = "isochronous", [5] = "f_parameters", [7] = "dxb_subscribers",
    [8] = "time_ar", [0x81] = "user_prm",
}
local BLOCK_SIZES = { [2] = 4, [4] = 24, [8] = 10 }
-- without CS Delay Time
local SHORTER_BLOCKS = { [8] = 2 }
local BLOCK_ENTRIES = { [3] = 4, [7] = 6 }

-- Data exchange broadcast (DXB): links of a subscriber, and their states
local dxb = {}

do
    local SINAMICS = 0xE2

    local function link_text(publisher, length, first, count, to, slot)
        local octets = count == 1 and string.format("octet %d", first)
            or string.format("octets %d..%d", first, first + count - 1)
        local where = to and string.format(" to output octet %d", to) or ""
        where = where .. (slot and string.format(" of slot %d", slot) or "")
        return string.format("%s of the %d of publisher %d%s", octets, length, publisher, where)
    end

    -- the links of SINAMICS's filter block as { text, place, size }; none where the octets are another maker's
    local function taps_of(data)
        local found = {}
        if #data < 2 or octet(data, 1) ~= SINAMICS or #data < 2 + octet(data, 2) then
            return found
        end
        local count = octet(data, 2)
        for number = 1, count do
            local from = octet(data, 2 + number)
            local upto = number < count and octet(data, 3 + number) or #data
            local size = upto - from
            if from < 2 + count or upto > #data or size < 2 or (size - 2) % 3 ~= 0 then
                return {}
            end
            for at = from + 2, upto - 3, 3 do
                local text = link_text(octet(data, from + 1), octet(data, from + 2), octet(data, at + 1),
                    octet(data, at + 3), octet(data, at + 2))
                found[#found + 1] = { text, at, 3 }
            end
        end
        return found
    end

    -- the links of a block of structured parameters of this type, whose data begin at `start`
    function dxb.links(nodes, kind, data, start)
        local found = {}
        if kind == SINAMICS then
            found = taps_of(data)
        elseif kind == 3 then
            for at = 1, #data - 4, 4 do
                local text = link_text(octet(data, at + 1), octet(data, at + 2), octet(data, at + 3),
                    octet(data, at + 4))
                found[#found + 1] = { text, at, 4 }
            end
        elseif kind == 7 then
            for at = 1, #data - 6, 6 do
                local text = link_text(octet(data, at + 1), octet(data, at + 2), octet(data, at + 3),
                    octet(data, at + 6), octet(data, at + 5), octet(data, at + 4))
                found[#found + 1] = { text, at, 6 }
            end
        end
        for _, one in ipairs(found) do
            node(nodes, "blocks.links", one[1], start + one[2], one[3])
        end
    end

    -- the links of a link status message in words; nil where the octets are no pairs
    function dxb.states(data)
        if #data == 0 or #data % 2 == 1 then
            return nil
        end
        local found = {}
        for at = 1, #data, 2 do
            local state = octet(data, at + 1)
            local words = bit(state, 0) and "data begin to come" or "no data"
            if bit(state, 6) then
                words = "the broadcast has another length than the filter"
            elseif bit(state, 7) then
                words = "valid data"
            end
            found[#found + 1] = string.format("publisher %d: %s", octet(data, at), words)
        end
        return table.concat(found, ", ")
    end
end

-- Blocks of redundancy (2), isochronous mode (4) and clock (8), as dpstack/dp/pdu/prm_checks.py has them
local checks = { texts = {}, found = {}, types = {} }
do
    local BASES = { [375] = true, [750] = true, [1500] = true, [3000] = true, [6000] = true, [12000] = true }
    local FUNCTIONS = { { 1, "primary request" }, { 2, "stop ms1" }, { 3, "start ms1" }, { 4, "check properties" },
        { 6, "master state clear" } }
    local CONTENTS = {
        [2] = { "function", 1, "properties", 1, "output_hold_time", 2 },
        [4] = { "version", 1, "t_base_dp", 4, "t_dp", 2, "t_mapc", 1, "t_base_io", 4, "t_i", 2, "t_o", 2, "t_dx", 4,
            "t_pll_w", 2, "t_pll_d", 2 },
        [8] = { "clock_sync_interval", 2, "cs_delay_seconds", 4, "cs_delay_fraction", 4 },
    }

    local function us_text(twelfths)
        local us = twelfths / 12
        return us >= 1000 and string.format("%g ms", us / 1000) or string.format("%g us", us)
    end

    local function isochronous_text(one)
        return "isochronous mode: " .. table.concat({
            "T_DP " .. us_text(one.t_dp * one.t_base_dp), string.format("T_MAPC %d", one.t_mapc),
            "T_I " .. us_text(one.t_i * one.t_base_io), "T_O " .. us_text(one.t_o * one.t_base_io),
            "T_DX " .. us_text(one.t_dx), "T_PLL_W " .. us_text(one.t_pll_w), "T_PLL_D " .. us_text(one.t_pll_d),
        }, ", ")
    end

    local function command_text(one, specifier)
        local names = {}
        for _, known in ipairs(FUNCTIONS) do
            if bit(one["function"], known[1]) then
                names[#names + 1] = known[2]
            end
        end
        return string.format("PrmCmd, sequence number %d: %s; output hold time %d ms", bits(specifier, 3, 5),
            #names > 0 and table.concat(names, ", ") or "no function", one.output_hold_time * 10)
    end

    local function clock_text(one)
        return string.format("clock: monitored for %g s, delay %g s", one.clock_sync_interval / 100,
            one.cs_delay_seconds + one.cs_delay_fraction / 4294967296)
    end

    local function finding(title, ...)
        checks.found[#checks.found + 1] = (title and "block of type " .. title .. ": " or "") .. string.format(...)
    end

    local function judge_isochronous(one)
        local title = "4 (isochronous)"
        if one.version ~= 1 then
            finding(title, "version %d: 1 is the only one", one.version)
        end
        for _, base in ipairs({ { "T_BASE_DP", one.t_base_dp }, { "T_BASE_IO", one.t_base_io } }) do
            if not BASES[base[2]] then
                finding(title, "%s %d: 375, 750, 1500, 3000, 6000, 12000 are possible", base[1], base[2])
            end
        end
        local cycle = one.t_dp * one.t_base_dp / 12
        if cycle < 500 or cycle > 32000 then
            finding(title, "a DP cycle (T_DP) of %g us: 500 us to 32 ms are possible", cycle)
        end
        if one.t_mapc < 1 or one.t_mapc > 14 then
            finding(title, "T_MAPC %d: 1 to 14 DP cycles are possible", one.t_mapc)
        end
        if one.t_dx / 12 > cycle then
            finding(title, "T_DX %s is longer than the DP cycle of %g us", us_text(one.t_dx), cycle)
        end
        if one.t_pll_w == 0 then
            finding(title, "T_PLL_W 0: the window of the PLL has 1/12 us at least")
        end
    end

    local function judge_command(one, specifier)
        local title, kind = "2 (prm_cmd)", one["function"]
        local reserved = (bit(kind, 0) and 1 or 0) + (bit(kind, 5) and 32 or 0) + (bit(kind, 7) and 128 or 0)
        if reserved > 0 then
            finding(title, "reserved bits 0x%02X in its function", reserved)
        end
        if bit(kind, 2) and bit(kind, 3) then
            finding(title, "it starts and stops MS1 at once")
        end
        if one.properties > 15 then
            finding(title, "reserved bits 0x%02X in its properties", one.properties - one.properties % 16)
        end
        if specifier % 8 > 0 then
            finding(title, "reserved bits 0x%02X beside its sequence number", specifier % 8)
        end
    end

    function checks.begin()
        checks.texts, checks.found, checks.types = {}, {}, {}
    end

    function checks.block(nodes, kind, specifier, data, start)
        checks.types[kind] = (checks.types[kind] or 0) + 1
        local layout_of = CONTENTS[kind]
        if not layout_of then
            return
        end
        local one, at = {}, 1
        for number = 1, #layout_of, 2 do
            local name, size, value = layout_of[number], layout_of[number + 1], 0
            for place = at, at + size - 1 do
                value = value * 256 + (string.byte(data, place) or 0)
            end
            one[name] = value
            local here = at <= #data
            node(nodes, "blocks.content." .. name, value, start + (here and at - 1 or 0), here and size or 1)
            at = at + size
        end
        local text = kind == 4 and isochronous_text(one) or kind == 2 and command_text(one, specifier) or clock_text(one)
        node(nodes, "blocks.text", text, start, math.max(#data, 1))
        checks.texts[#checks.texts + 1] = text
        if kind == 4 then
            judge_isochronous(one)
        elseif kind == 2 then
            judge_command(one, specifier)
        end
    end

    function checks.all(nodes, status_3)
        local types = checks.types
        if types[4] then
            node(nodes, "demands", "isochronous mode (its Set_Prm has a block of type 4 (isochronous))", 9)
        elseif bit(status_3, 4) then
            node(nodes, "demands", "isochronous mode (IsoM_Req is set in its DPV1_Status_3)", 9)
        end
        for _, kind in ipairs({ 2, 4, 8 }) do
            if (types[kind] or 0) > 1 then
                finding(nil, "%d blocks of type %d: one is possible", types[kind], kind)
            end
        end
        if types[4] and not bit(status_3, 4) then
            finding(nil, "a block of type 4 (isochronous), but IsoM_Req (DPV1_Status_3, bit 4) is not set")
        end
        if bit(status_3, 4) and not types[4] then
            finding(nil, "IsoM_Req (DPV1_Status_3, bit 4) is set, but no block of type 4 (isochronous) follows")
        end
        if types[2] and not bit(status_3, 7) then
            finding(nil, "a block of type 2 (prm_cmd), but PrmCmd (DPV1_Status_3, bit 7) is not set")
        end
        for _, line in ipairs(checks.found) do
            node(nodes, "findings", line, 9)
        end
    end
end

local function prm_blocks(nodes, data, start)
    local at, number = start, 0
    while at < #data do
        number = number + 1
        local where = string.format("octet %d: parameter block %d", at + 1, number)
        local left = #data - at
        if left < 4 then
            refuse("%s has a head of 4 octets, there are %d", where, left)
        end
        local length, kind, slot = octet(data, at + 1), octet(data, at + 2), octet(data, at + 3)
        if length < 4 or length > left then
            refuse("%s says it has %s: a block has 4 at least, and %d are left", where, octets_text(length), left)
        end
        local count = length - 4
        local name = BLOCK_NAMES[kind]
        local title = "type " .. kind .. (name and " (" .. name .. ")" or "")
        if slot > 254 then
            refuse("%s: parameter block of type %d for slot %d: type and specifier 0..255, slot 0..254", where, kind, slot)
        elseif count > 230 then
            refuse("%s: parameter block of type %d: %d octets, 230 are possible", where, kind, count)
        elseif BLOCK_SIZES[kind] and count ~= BLOCK_SIZES[kind] and count ~= SHORTER_BLOCKS[kind] then
            refuse("%s: %s has %d octets of data, there are %d", where, title, BLOCK_SIZES[kind], count)
        elseif BLOCK_ENTRIES[kind] and count % BLOCK_ENTRIES[kind] ~= 1 then
            refuse("%s: %s has a version and entries of %d octets each, there are %d octets", where, title,
                BLOCK_ENTRIES[kind], count)
        end
        local inner = group(nodes, "Block of " .. title .. ", slot " .. slot, at, length)
        node(inner, "blocks.type", kind, at + 1)
        node(inner, "blocks.slot", slot, at + 2)
        node(inner, "blocks.specifier", octet(data, at + 4), at + 3)
        node_octets(inner, "blocks.data", at + 4, count)
        checks.block(inner, kind, octet(data, at + 4), string.sub(data, at + 5, at + length), at + 4)
        dxb.links(inner, kind, string.sub(data, at + 5, at + length), at + 4)
        at = at + length
    end
end

local function set_prm(data)
    checks.begin()
    check(SET_PRM, data)
    if #data > 7 + MAX_USER_PRM then
        refuse("Set_Prm has %d octets, octet %d is the last possible one", #data, 7 + MAX_USER_PRM)
    end
    local first, fact_1, fact_2 = octet(data, 1), octet(data, 2), octet(data, 3)
    local nodes = {}
    node(nodes, "lock_req", bit(first, 7), 0)
    node(nodes, "unlock_req", bit(first, 6), 0)
    node(nodes, "sync_req", bit(first, 5), 0)
    node(nodes, "freeze_req", bit(first, 4), 0)
    node(nodes, "wd_on", bit(first, 3), 0)
    node(nodes, "wd_fact_1", fact_1, 1)
    node(nodes, "wd_fact_2", fact_2, 2)
    local base = 10
    local dpv1 = #data >= 10 and octet(data, 8) >= 128
    if dpv1 and bit(octet(data, 8), 2) then
        base = 1
    end
    if bit(first, 3) then
        node(nodes, "watchdog_ms", base * fact_1 * fact_2, 1, 2)
    end
    node(nodes, "min_t_sdr", octet(data, 4), 3)
    node(nodes, "ident_number", word(data, 5), 4, 2)
    node_groups(nodes, "group_ident", octet(data, 7), 6)
    if not dpv1 then
        node_octets(nodes, "user_prm_data", 7, #data - 7)
        return nodes
    end
    local status_1, status_2, status_3 = octet(data, 8), octet(data, 9), octet(data, 10)
    local inner = group(nodes, "DPV1_Status", 7, 3)
    node(inner, "dpv1_enable", true, 7)
    node(inner, "fail_safe", bit(status_1, 6), 7)
    node(inner, "publisher_enable", bit(status_1, 5), 7)
    node(inner, "wd_base_1ms", bit(status_1, 2), 7)
    node(inner, "check_cfg_mode", bit(status_2, 0), 8)
    for _, kind in ipairs(ALARM_KINDS) do
        if bit(status_2, kind[1]) then
            node(inner, "alarms", kind[2], 8)
        end
    end
    node(inner, "alarm_mode", ALARM_LIMITS[status_3 % 8], 9)
    node(inner, "prm_structure", bit(status_3, 3), 9)
    node(inner, "prmcmd", bit(status_3, 7), 9)
    node(inner, "isom_req", bit(status_3, 4), 9)
    if bit(status_3, 3) then
        prm_blocks(nodes, data, 10)
    else
        node_octets(nodes, "user_prm_data", 10, #data - 10)
    end
    if bit(status_3, 3) or bit(status_3, 4) then
        checks.all(nodes, status_3)
    end
    return nodes
end

-- the blocks of redundancy, isochronous mode and clock in words, what they demand, and what is wrong in them
function checks.text(data)
    local good, nodes = pcall(set_prm, data)
    if not good then
        if type(nodes) == "table" then
            return ""
        end
        error(nodes, 0)
    end
    local words = {}
    for _, text in ipairs(checks.texts) do
        words[#words + 1] = text
    end
    for _, one in ipairs(nodes) do
        if one.key == "demands" then
            words[#words + 1] = "demands " .. one.value
        elseif one.key == "findings" then
            words[#words + 1] = one.value
        end
    end
    return table.concat(words, "; ")
end

-- --- Chk_Cfg, Get_Cfg ------------------------------------------------------------------------------------------------

-- octets of data that a length octet stands for, and whether they are consistent as a whole
local function data_length(value)
    return (value % 64 + 1) * (bit(value, 6) and 2 or 1), value >= 128
end

local function configuration(data)
    local nodes, at = {}, 0
    while at < #data do
        local start, head = at, octet(data, at + 1)
        local inputs, outputs, manufacturer = 0, 0, 0
        local consistent = false
        at = at + 1
        if bits(head, 4, 2) ~= 0 then
            -- the general format: bits 5..4 say the direction, the others are a length octet of four bits
            local length, whole = data_length(head - bits(head, 4, 2) * 16)
            inputs = bit(head, 4) and length or 0
            outputs = bit(head, 5) and length or 0
            consistent = whole
        else
            local lengths = {}
            for _ = 1, (bit(head, 7) and 1 or 0) + (bit(head, 6) and 1 or 0) do
                if at >= #data then
                    refuse("identifier octet %d (0x%02x) announces a length octet that is missing", start, head)
                end
                lengths[#lengths + 1] = octet(data, at + 1)
                at = at + 1
            end
            -- output length first, then input length
            if bit(head, 6) then
                local length, whole = data_length(table.remove(lengths))
                inputs, consistent = length, consistent or whole
            end
            if bit(head, 7) then
                local length, whole = data_length(table.remove(lengths))
                outputs, consistent = length, consistent or whole
            end
            manufacturer = head % 16 ~= 15 and head % 16 or 0
        end
        if at + manufacturer > #data then
            refuse("identifier octet %d (0x%02x) announces %d manufacturer octets, %d are left", start, head,
                manufacturer, #data - at)
        end
        local last = at + manufacturer
        local inner = group(nodes, string.format("Module: %d octets in, %d out", inputs, outputs), start, last - start)
        node_octets(inner, "cfg_data.identifier", start, last - start)
        node(inner, "cfg_data.inputs", inputs, start)
        node(inner, "cfg_data.outputs", outputs, start)
        node(inner, "cfg_data.consistent", consistent, start)
        node_octets(inner, "cfg_data.manufacturer", at, manufacturer)
        at = last
    end
    return nodes
end

-- --- Global_Control, Set_Slave_Add -----------------------------------------------------------------------------------

local GLOBAL_CONTROL = layout("Global_Control", false, "reserved_high", 2, "sync", 1, "unsync", 1, "freeze", 1,
    "unfreeze", 1, "clear", 1, "reserved_low", 1, "group_select", 8)

local function global_control(data)
    check(GLOBAL_CONTROL, data)
    local control = octet(data, 1)
    local nodes = {}
    node(nodes, "clear_data", bit(control, 1), 0)
    node(nodes, "unfreeze", bit(control, 2), 0)
    node(nodes, "freeze", bit(control, 3), 0)
    node(nodes, "unsync", bit(control, 4), 0)
    node(nodes, "sync", bit(control, 5), 0)
    node_groups(nodes, "group_select", octet(data, 2), 1)
    local reserved = control - bits(control, 1, 5) * 2
    if reserved > 0 then
        node(nodes, "reserved", reserved, 0)
    end
    return nodes
end

local SET_SLAVE_ADD = layout("Set_Slave_Add", true, "new_address", 8, "ident", 16, "no_add_chg", 8)

local function set_slave_add(data)
    check(SET_SLAVE_ADD, data)
    local nodes = {}
    node(nodes, "new_slave_add", octet(data, 1), 0)
    node(nodes, "ident_number", word(data, 2), 1, 2)
    node(nodes, "no_add_chg", octet(data, 4) ~= 0, 3)
    node_octets(nodes, "rem_slave_data", 4, #data - 4)
    return nodes
end

-- --- Clock_Value ---------------------------------------------------------------------------------------------------

-- a main chunk of Lua has 200 locals at most: those of this part end with it
local clock = {}

do
    local FIRST_OF_1900, TO_1970 = 0x9DFF4400, 2208988800
    local RESOLUTIONS = { [0] = 1, 10, 100, 1000 }

    -- year, month and day of the days since 1970-01-01 (Gregorian calendar)
    local function date_of(days)
        local shifted = days + 719468
        local era = math.floor(shifted / 146097)
        local day = shifted - era * 146097
        local leap = math.floor(day / 1460) - math.floor(day / 36524) + math.floor(day / 146096)
        local year = math.floor((day - leap) / 365)
        local rest = day - (365 * year + math.floor(year / 4) - math.floor(year / 100))
        local month = math.floor((5 * rest + 2) / 153)
        local first = math.floor((153 * month + 2) / 5)
        local real = month < 10 and month + 3 or month - 9
        return year + era * 400 + (real <= 2 and 1 or 0), real, rest - first + 1
    end

    -- UTC with milliseconds of the eight octets from `at` on; the fraction is rounded to ns, as the decoder does
    local function time_text(data, at)
        local seconds = word(data, at) * 65536 + word(data, at + 2)
        local ns = math.floor((word(data, at + 4) * 1000000000
            + math.floor((word(data, at + 6) * 1000000000 + 2147483648) / 65536)) / 65536)
        if seconds < FIRST_OF_1900 then
            seconds = seconds + 4294967296
        end
        local since = seconds - TO_1970 + math.floor(ns / 1000000000)
        local year, month, day = date_of(math.floor(since / 86400))
        local left = since % 86400
        return string.format("%04d-%02d-%02d %02d:%02d:%02d.%03d", year, month, day, math.floor(left / 3600),
            math.floor(left / 60) % 60, left % 60, math.floor(ns % 1000000000 / 1000000))
    end

    local function clock_parts(data)
        if #data ~= 18 then
            refuse("Clock_Value has 18 octets, not %s", octets_text(#data))
        end
        local one, two = octet(data, 17), octet(data, 18)
        local correction = bits(one, 2, 5)
        local previous = string.find(string.sub(data, 9, 16), "[^%z]") and time_text(data, 9) or nil
        return {
            time = time_text(data, 1), previous = previous, correction = bit(one, 7) and -correction or correction,
            announced = bit(two, 7), summer = bit(two, 6), resolution = RESOLUTIONS[bits(two, 3, 2)],
            unsynchronised = bit(two, 0),
        }
    end

    function clock.nodes(data)
        local found = clock_parts(data)
        local nodes = {}
        node(nodes, "clock_value_time_event", found.time, 0, 8)
        if found.previous then
            node(nodes, "clock_value_previous_te", found.previous, 8, 8)
        end
        node(nodes, "cv", found.correction, 16)
        node(nodes, "anh", found.announced, 17)
        node(nodes, "swt", found.summer, 17)
        node(nodes, "cr_ms", found.resolution, 17)
        node(nodes, "syf", found.unsynchronised, 17)
        return nodes
    end

    function clock.text(data)
        local found = clock_parts(data)
        local parts = { found.time .. " UTC", string.format("resolution %d ms", found.resolution) }
        if found.correction ~= 0 then
            local minutes = math.abs(found.correction) * 30
            parts[#parts + 1] = string.format("correction %s%d:%02d h (local time)", found.correction < 0 and "-" or "+",
                math.floor(minutes / 60), minutes % 60)
        end
        if found.summer then
            parts[#parts + 1] = "summer time"
        end
        if found.announced then
            parts[#parts + 1] = "summer time changes within an hour"
        end
        if found.unsynchronised then
            parts[#parts + 1] = "clock not synchronised"
        end
        return table.concat(parts, ", ")
    end

    function clock.is_value(telegram)
        return telegram.request and telegram.func == 0 and telegram.fc >= 128
    end
end

-- --- Slave_Diag ------------------------------------------------------------------------------------------------------

local DIAG_FLAGS = {
    { 1, 0, "station_non_existent" }, { 1, 1, "station_not_ready" }, { 1, 2, "cfg_fault" }, { 1, 3, "ext_diag" },
    { 1, 4, "not_supported" }, { 1, 5, "invalid_slave_response" }, { 1, 6, "prm_fault" }, { 1, 7, "master_lock" },
    { 2, 0, "prm_req" }, { 2, 1, "stat_diag" }, { 2, 3, "wd_on" }, { 2, 4, "freeze_mode" }, { 2, 5, "sync_mode" },
    { 2, 6, "not_present" }, { 2, 7, "deactivated" }, { 3, 7, "ext_diag_overflow" },
}
local SIZES = { [0] = "unspecific", "bit", "2 bits", "4 bits", "byte", "word", "2 words", "reserved" }
local CHANNEL_ERRORS = {
    "short circuit", "undervoltage", "overvoltage", "overload", "overtemperature", "line break",
    "upper limit exceeded", "lower limit exceeded", "error",
}
local ALARM_NAMES = { "diagnosis", "process", "pull", "plug", "status", "update" }
local STATUS_NAMES = {
    [1] = "status message", [2] = "module status", [3] = "DXB link status", [30] = "PrmCmdAck", [31] = "Red_State",
}
local SPECIFIERS = {
    [0] = "", "appears, slot disturbed", "disappears, slot is good", "disappears, slot still disturbed",
}
local MODULE_STATES = { [0] = "ok", "data invalid", "wrong module", "no module" }
local PRM_FUNCTIONS = {
    { 1, "primary request" }, { 2, "stop ms1" }, { 3, "start ms1" }, { 4, "check properties" },
    { 6, "master state clear" },
}
local RED_STATES = {
    { 0, "backup" }, { 1, "primary" }, { 2, "hardware defect" }, { 3, "data exchange" }, { 4, "master state clear" },
    { 5, "baud rate found" }, { 6, "output hold time" },
}

local function is_vendor(number)
    return number >= 32 and number <= 126
end

local function alarm_name(number)
    if ALARM_NAMES[number] then
        return ALARM_NAMES[number] .. " alarm"
    end
    return (is_vendor(number) and "vendor alarm " or "alarm of reserved type ") .. number
end

local function flag_names(value, known)
    local names, left = {}, value
    for _, one in ipairs(known) do
        if bit(value, one[1]) then
            names[#names + 1] = one[2]
            left = left - POWERS[one[1]]
        end
    end
    if left > 0 then
        names[#names + 1] = string.format("0x%02X (reserved)", left)
    end
    return #names > 0 and table.concat(names, ", ") or "none"
end

-- An alarm or a status from a device related block with its header; nil where it is none.
local function message_of(block)
    if #block < 4 or octet(block, 1) ~= #block then
        return nil
    end
    local second, slot, last = octet(block, 2), octet(block, 3), octet(block, 4)
    local is_status, kind = second >= 128, second % 128
    if slot > 254 or not ((is_status and STATUS_NAMES or ALARM_NAMES)[kind] or is_vendor(kind)) then
        return nil
    end
    local found = {
        is_status = is_status, type = kind, slot = slot, specifier = last % 4, data = string.sub(block, 5),
        sequence = bits(last, 3, 5), add_ack = bit(last, 2),
    }
    local how = SPECIFIERS[found.specifier]
    local title = alarm_name(kind)
    if is_status then
        title = STATUS_NAMES[kind] or "vendor status " .. kind
    end
    if is_status and kind == 2 then
        local bad = {}
        for at = 1, #found.data do
            for place = 0, 3 do
                local state = bits(octet(found.data, at), 2 * place, 2)
                if state > 0 then
                    bad[#bad + 1] = string.format("slot %d %s", 4 * (at - 1) + place + 1, MODULE_STATES[state])
                end
            end
        end
        found.text = title .. ": " .. (#bad > 0 and table.concat(bad, ", ") or "all modules ok")
        return found
    end
    if is_status and kind == 3 and dxb.states(found.data) then
        found.text = title .. ": " .. dxb.states(found.data)
        return found
    end
    if is_status and kind == 126 and #found.data >= 4 then
        title = "PROFIBUS PA diagnosis"
        how = ({ [0] = "", "a message appears", "a message disappears", "a message disappears" })[found.specifier]
    end
    if is_status and (kind == 30 or kind == 31) and #found.data >= 3 then
        how = string.format("sequence number %d, function: %s; this side: %s; the other side: %s", found.sequence,
            flag_names(octet(found.data, 1), PRM_FUNCTIONS), flag_names(octet(found.data, 2), RED_STATES),
            flag_names(octet(found.data, 3), RED_STATES))
    end
    found.text = string.format("%s, slot %d", title, slot) .. (how ~= "" and ", " .. how or "")
    return found
end

-- The blocks of an extended diagnosis: { kind, value, from (1 is the first octet), octets }; and the fault in its lengths.
local function split_blocks(ext)
    local blocks, at = {}, 1
    while at <= #ext do
        local head = octet(ext, at)
        local kind, value = bits(head, 6, 2), head % 64
        local announced = ({ [0] = value, value, 3, 1 })[kind]
        local left = #ext - at + 1
        if announced == 0 then
            return blocks, string.format("octet %d announces a block without any octets, %s left undecoded", at + 6,
                octets_text(left))
        end
        local octets = string.sub(ext, at, at + announced - 1)
        if kind ~= 2 or left >= 3 then
            blocks[#blocks + 1] = { kind = kind, value = value, from = at, octets = octets }
        end
        if announced > left then
            return blocks, string.format("octet %d announces a block of %d octets, %d are left", at + 6, announced, left)
        end
        at = at + announced
    end
    return blocks
end

local function channel_text(block)
    local second, third = octet(block.octets, 2), octet(block.octets, 3)
    local input, output = bit(second, 6), bit(second, 7)
    local kind = input and (output and "in/output " or "input ") or (output and "output " or "")
    local number = third % 32
    return string.format("slot %d, %schannel %d (%s): %s", 1 + block.value, kind, second % 64, SIZES[bits(third, 5, 3)],
        CHANNEL_ERRORS[number] or "error " .. number)
end

local function utf8_of(latin_1)
    return (string.gsub(latin_1, "[\192-\255]", function(letter)
        return "\195" .. string.char(string.byte(letter) - 64)
    end))
end

-- The text that a device put into `octets`, in latin-1; empty if they hold none. A piece has four characters or more, two of
-- them letters of ASCII, and most of them such letters, digits and blanks.
local function readable(octets)
    local pieces = {}
    for piece in string.gmatch(octets, "[\32-\126\192-\255]+") do
        local _, letters = string.gsub(piece, "[A-Za-z]", "")
        local _, of_words = string.gsub(piece, "[A-Za-z0-9 ]", "")
        if #piece >= 4 and letters >= 2 and 2 * of_words > #piece then
            pieces[#pieces + 1] = string.match(piece, "^ *(.-) *$")
        end
    end
    return table.concat(pieces, " ... ")
end

-- Octets of a device in hex; text in them in quotes before that, and alone if there is nothing else.
local function octets_in_words(octets)
    local text = readable(octets)
    local hex = string.gsub(octets, ".", function(one)
        return string.format("%02x ", string.byte(one))
    end):sub(1, -2)
    if text == "" then
        return hex
    end
    local rest = string.match(string.gsub(octets, "[%z ]+$", ""), "^ *(.*)$")
    local alone = #rest >= 8 and rest == text
    return '"' .. utf8_of(text) .. '"' .. (alone and "" or " (" .. hex .. ")")
end

-- The text of a block that is no alarm and no status, in slots from 1; nil where it reports nothing.
local function block_text(block)
    if block.kind == 2 then
        return channel_text(block)
    elseif block.kind == 1 then
        local slots = {}
        for place = 2, #block.octets do
            for number = 0, 7 do
                if bit(octet(block.octets, place), number) then
                    slots[#slots + 1] = 1 + 8 * (place - 2) + number
                end
            end
        end
        return #slots > 0 and "slots with a diagnosis: " .. table.concat(slots, ", ") or nil
    elseif block.kind == 0 and string.find(block.octets, "[^%z]", 2) then
        return "device: " .. octets_in_words(string.sub(block.octets, 2))
    end
    return nil
end

local function diag_block(nodes, block)
    local at, size = 5 + block.from, #block.octets
    local prefix = "ext_diag_data."
    if block.kind == 2 then
        local text = channel_text(block)
        local inner = group(nodes, "Channel: " .. text, at, size)
        node(inner, prefix .. "kind", "channel", at)
        node(inner, prefix .. "module", block.value, at)
        node(inner, prefix .. "channel", octet(block.octets, 2) % 64, at + 1)
        node(inner, prefix .. "error", octet(block.octets, 3) % 32, at + 2)
        node(inner, prefix .. "text", text, at, size)
    elseif block.kind == 1 then
        local text = block_text(block)
        local inner = group(nodes, text or "Modules with a diagnosis: none", at, size)
        node(inner, prefix .. "kind", "identifier", at)
        for place = 2, size do
            for number = 0, 7 do
                if bit(octet(block.octets, place), number) then
                    node(inner, prefix .. "modules", 8 * (place - 2) + number, at + place - 1)
                end
            end
        end
        if text then
            node(inner, prefix .. "text", text, at, size)
        end
    elseif block.kind == 3 then
        local inner = group(nodes, "Revision", at, size)
        node(inner, prefix .. "kind", "revision", at)
        node(inner, prefix .. "revision", block.value, at)
    else
        local message = message_of(block.octets)
        local inner = group(nodes, "Device" .. (message and ", with DP-V1: " .. message.text or ""), at, size)
        node(inner, prefix .. "kind", "device", at)
        node_octets(inner, prefix .. "data", at + 1, size - 1)
        local characters = readable(string.sub(block.octets, 2))
        if characters ~= "" then
            node(inner, prefix .. "characters", utf8_of(characters), at + 1, size - 1)
        end
        local text = not message and block_text(block)
        if text then
            node(inner, prefix .. "text", text, at, size)
        elseif message then
            local name = message.is_status and "status" or "alarm"
            prefix = prefix .. "if_dpv1."
            node(inner, prefix .. name .. "_type", message.type, at + 1)
            node(inner, prefix .. "slot_number", message.slot, at + 2)
            node(inner, prefix .. name .. "_specifier", message.specifier, at + 3)
            if not message.is_status then
                node(inner, prefix .. "seq_nr", message.sequence, at + 3)
                node(inner, prefix .. "add_ack", message.add_ack, at + 3)
            end
            node_octets(inner, prefix .. "data", at + 4, size - 4)
            node(inner, prefix .. "text", message.text, at, size)
        end
    end
end

local function slave_diag(data)
    if #data < 6 or #data > 244 then
        refuse("Slave_Diag has %d octets, 6..244 are possible", #data)
    end
    local nodes = {}
    for _, flag in ipairs(DIAG_FLAGS) do
        if bit(octet(data, flag[1]), flag[2]) then
            node(nodes, "flags", flag[3], flag[1] - 1)
        end
    end
    if octet(data, 4) ~= 255 then
        node(nodes, "master_add", octet(data, 4), 3)
    end
    node(nodes, "ident_number", word(data, 5), 4, 2)
    local ext = string.sub(data, 7)
    local blocks, finding = split_blocks(ext)
    local used = 0
    for _, block in ipairs(blocks) do
        diag_block(nodes, block)
        used = used + #block.octets
    end
    if finding then
        node_octets(nodes, "rest", 6 + used, #ext - used)
        node(nodes, "finding", finding, 6, #ext)
    end
    return nodes
end

-- --- DP-V1: records, alarms, class 2 connections ---------------------------------------------------------------------

local IDLE, DATA_TRANSPORT, RESOURCE_MANAGER, INITIATE, ABORT, ALARM_ACK, READ, WRITE =
    0x48, 0x51, 0x56, 0x57, 0x58, 0x5C, 0x5E, 0x5F
local FUNCTIONS = {
    [IDLE] = "Idle", [DATA_TRANSPORT] = "Data_Transport", [RESOURCE_MANAGER] = "Resource_Manager",
    [INITIATE] = "Initiate", [ABORT] = "Abort", [ALARM_ACK] = "Alarm_Ack", [READ] = "Read", [WRITE] = "Write",
}
local MAX_RECORD = 240

local RECORD = layout("DP-V1 service", true, "function", 8, "slot", 8, "record", 8, "length", 8)
local NEGATIVE = layout("DP-V1 negative response", false, "function", 8, "error_decode", 8, "error_code_1", 8,
    "error_code_2", 8)
local ACK = layout("Alarm_Ack", false, "function", 8, "slot", 8, "kind", 8, "specifier", 5, "add_ack", 1,
    "specifier", 2)
local MANAGER = layout("Resource_Manager", false, "function", 8, "server_sap", 8, "send_timeout", 16)
local ABORT_FORM = layout("Abort", true, "function", 8, "subnet", 8, "reserved", 2, "instance", 2, "reason", 4)
local INITIATE_REQ = layout("Initiate", true, "function", 8, "reserved", 24, "send_timeout", 16, "features", 16,
    "profile_features", 16, "profile_ident", 16, "s_type", 8, "s_len", 8, "d_type", 8, "d_len", 8)
local INITIATE_RES = layout("Initiate", true, "function", 8, "max_len_data_unit", 8, "features", 16,
    "profile_features", 16, "profile_ident", 16, "s_type", 8, "s_len", 8, "d_type", 8, "d_len", 8)

local SUBNETS = { [1] = " in its own subnet", [2] = " in a remote subnet" }
local REASONS = {
    [1] = "a service that is not allowed in this state (ABT_SE",
    [2] = "a request that cannot be read (ABT_FE",
    [3] = "nothing was heard from the other end in time (ABT_TO",
    [4] = "a response that cannot be read (ABT_RE",
    [5] = "an impossible service of its user (ABT_IV",
    [6] = "the send time-out asked for is too short (ABT_STO",
    [7] = "an address in Initiate (API, access level, network) that it does not have (ABT_IA",
    [8] = "it still waits for the end of a service (ABT_OC",
    [15] = "it has no connection left (ABT_RES",
}
local LINK_REASONS = {
    [1] = "an error of the user (UE", [2] = "no resource (RR", [3] = "the service access point is closed (RS",
    [9] = "no data (NR", [10] = "data, high priority (DH", [11] = "no resource at the own station (LR",
    [12] = "data, low priority, but no resource (RDL", [13] = "data, high priority, but no resource (RDH",
    [14] = "not in the logical ring (DS", [15] = "the other station does not answer (NA",
}

local function abort_text(subnet, instance, reason)
    local where = SUBNETS[subnet] or ""
    if instance == 2 then
        return string.format("its user, reason %d%s", reason, where)
    elseif instance == 3 then
        return string.format("instance %d, reason %d%s, both reserved", instance, reason, where)
    end
    local text = (instance == 1 and REASONS or LINK_REASONS)[reason] or "a reserved reason (reason " .. reason
    return (instance == 0 and "its link layer: " or "") .. text .. where .. ")"
end

local CODES = {
    [0xA0] = "read error", [0xA1] = "write error", [0xA2] = "module failure", [0xA8] = "version conflict",
    [0xA9] = "feature not supported", [0xB0] = "invalid index", [0xB1] = "write length error", [0xB2] = "invalid slot",
    [0xB3] = "type conflict", [0xB4] = "invalid area", [0xB5] = "state conflict", [0xB6] = "access denied",
    [0xB7] = "invalid range", [0xB8] = "invalid parameter", [0xB9] = "invalid type",
    [0xC0] = "read constraint conflict", [0xC1] = "write constraint conflict", [0xC2] = "resource busy",
    [0xC3] = "resource unavailable",
}
-- classes by the standard, and the code from which on they are the device's own
local CLASSES = { [10] = { "application", 10 }, [11] = { "access", 10 }, [12] = { "resource", 8 } }

local function class_text(class)
    return CLASSES[class] and CLASSES[class][1] or (class > 12 and "device specific" or "reserved")
end

local function code_text(code)
    local class, number = bits(code, 4, 4), code % 16
    if CODES[code] then
        return CODES[code]
    elseif not CLASSES[class] then
        return class > 12 and class_text(class) .. ": see the device's manual" or "reserved"
    elseif number >= CLASSES[class][2] then
        return class_text(class) .. ": device specific, see its manual"
    end
    return class_text(class) .. ": reserved code " .. number
end

local function negative_text(decoding, code_1, code_2)
    local octets = string.format("%02X %02X %02X", decoding, code_1, code_2)
    if decoding == 0x80 then
        local more = code_2 > 0 and string.format(", code 2: 0x%02X", code_2) or ""
        return string.format("%s (%s: class %s, code %d%s)", code_text(code_1), octets, class_text(bits(code_1, 4, 4)),
            code_1 % 16, more)
    elseif decoding >= 0xFE then
        return string.format("an error in the codes of %s (%s); its manual knows them",
            decoding == 0xFE and "FMS" or "HART", octets)
    end
    return string.format("an error whose codes have no meaning here (%s: Error_Decode 0x%02X is unknown)", octets,
        decoding)
end

local function address(name, at, kind, size)
    if not ((kind == 0 and size == 2) or (kind == 1 and size >= 8)) then
        refuse("Initiate: %s of type %d with %d octets; type 0 has 2, type 1 at least 8", name, kind, size)
    end
    return { name = name, at = at, size = size }
end

local function node_address(nodes, data, one)
    local inner = group(nodes, one.name, one.at, one.size)
    local prefix = string.lower(one.name)
    node(inner, prefix .. ".api", octet(data, one.at + 1), one.at)
    node(inner, prefix .. ".scl", octet(data, one.at + 2), one.at + 1)
    node_octets(inner, prefix .. ".net", one.at + 2, one.size - 2)
end

local function initiate(nodes, data, request)
    check(request and INITIATE_REQ or INITIATE_RES, data)
    local at = request and 6 or 2
    local lengths = at + 6
    local s_type, s_len = octet(data, lengths + 1), octet(data, lengths + 2)
    local d_type, d_len = octet(data, lengths + 3), octet(data, lengths + 4)
    local first = lengths + 4
    if s_len + d_len ~= #data - first then
        refuse("Initiate: %d and %d octets of addresses are announced, %d came", s_len, d_len, #data - first)
    end
    local source = address("S_Addr", first, s_type, s_len)
    local destination = address("D_Addr", first + s_len, d_type, d_len)
    if request then
        node(nodes, "send_timeout_s", word(data, 5) / 100, 4, 2)
    else
        node(nodes, "max_len_data_unit", octet(data, 2), 1)
    end
    node(nodes, "features_supported", word(data, at + 1), at, 2)
    node(nodes, "profile_features_supported", word(data, at + 3), at + 2, 2)
    node(nodes, "profile_ident_number", word(data, at + 5), at + 4, 2)
    node_address(nodes, data, source)
    node_address(nodes, data, destination)
    if request then
        return string.format("Initiate, send time-out %s s", string.format("%g", word(data, 5) / 100))
    end
    return string.format("Initiate, up to %d octets of data", octet(data, 2))
end

-- Read, Write, Data_Transport: the four octets of their head are checked by the caller
local function node_record(nodes, data)
    node(nodes, "slot_number", octet(data, 2), 1)
    node(nodes, "index", octet(data, 3), 2)
end

local function record_title(name, data)
    return string.format("%s of slot %d, index %d", name, octet(data, 2), octet(data, 3))
end

local function record_request(nodes, data)
    local number = octet(data, 1)
    if number ~= READ and number ~= WRITE then
        local name = FUNCTIONS[number]
        refuse("octet 1: %s", name and name .. " is no service here" or string.format("no service 0x%02X", number))
    end
    check(RECORD, data)
    local length, came = octet(data, 4), #data - 4
    if octet(data, 2) > 254 then
        refuse("octet 2: there is no slot %d", octet(data, 2))
    elseif length > MAX_RECORD then
        refuse("octet 4: %d octets of data, %d are possible", length, MAX_RECORD)
    end
    node_record(nodes, data)
    if number == READ then
        if came > 0 then
            refuse("%s too many: octet 4 is the last one of a Read request", octets_text(came))
        end
        node(nodes, "length", length, 3)
        return string.format("%s, up to %d", record_title("Read", data), length)
    elseif length ~= came then
        refuse("octet 4 says %s of data, %d came", octets_text(length), came)
    end
    node_octets(nodes, "data", 4, came)
    return string.format("%s, data %d", record_title("Write", data), came)
end

local function record_response(nodes, data)
    local number = octet(data, 1)
    local name = FUNCTIONS[number % 128]
    if not name then
        refuse("DP-V1 response: octet 1 is 0x%02X, which is no service", number)
    elseif number >= 128 then
        check(NEGATIVE, data)
        local text = negative_text(octet(data, 2), octet(data, 3), octet(data, 4))
        node(nodes, "error_decode", octet(data, 2), 1)
        node(nodes, "error_code_1", octet(data, 3), 2)
        node(nodes, "error_code_2", octet(data, 4), 3)
        node(nodes, "text", text, 1, 3)
        return name .. " refused: " .. text
    end
    check(RECORD, data)
    local length, came = octet(data, 4), #data - 4
    if number == WRITE then
        if came > 0 then
            refuse("Write response has %d octets, octet 4 is the last one", #data)
        end
        node_record(nodes, data)
        node(nodes, "length", length, 3)
        return string.format("%s, data %d", record_title("Write", data), length)
    elseif length ~= came or length > MAX_RECORD then
        refuse("Read response: octet 4 says %s of data, %d came", octets_text(length), came)
    end
    node_record(nodes, data)
    node_octets(nodes, "data", 4, came)
    return string.format("%s, data %d", record_title("Read", data), came)
end

-- The nodes of a PDU of MS1 or MS2, and a text for people. Raises what `refuse` raises.
local function dpv1(data, request)
    local number = octet(data, 1)
    local nodes = {}
    node(nodes, "function_num", number, 0)
    if FUNCTIONS[number % 128] then
        node(nodes, "function", FUNCTIONS[number % 128], 0)
    end
    local text
    if number == IDLE then
        text = "Idle"
    elseif number == ABORT then
        check(ABORT_FORM, data)
        local subnet, last = octet(data, 2), octet(data, 3)
        text = abort_text(subnet, bits(last, 4, 2), last % 16)
        node(nodes, "subnet", subnet, 1)
        node(nodes, "instance", bits(last, 4, 2), 2)
        node(nodes, "reason_code", last % 16, 2)
        node(nodes, "text", text, 1, 2)
        text = "Abort: " .. text
    elseif number == RESOURCE_MANAGER then
        check(MANAGER, data)
        if octet(data, 2) > 48 then
            refuse("Resource_Manager: octet 2: %d is no server SAP (0..48)", octet(data, 2))
        end
        local timeout = word(data, 3) / 100
        node(nodes, "server_sap", octet(data, 2), 1)
        node(nodes, "send_timeout_s", timeout, 2, 2)
        text = string.format("server SAP %d, send time-out %s s", octet(data, 2), string.format("%g", timeout))
    elseif number == INITIATE then
        text = initiate(nodes, data, request)
    elseif number == ALARM_ACK then
        check(ACK, data)
        local kind, last = octet(data, 3), octet(data, 4)
        node(nodes, "slot_number", octet(data, 2), 1)
        node(nodes, "alarm_type", kind, 2)
        node(nodes, "alarm", alarm_name(kind), 2)
        node(nodes, "alarm_specifier", last % 4, 3)
        node(nodes, "seq_nr", bits(last, 3, 5), 3)
        node(nodes, "add_ack", bit(last, 2), 3)
        text = string.format("Alarm_Ack of %s, slot %d, sequence number %d", alarm_name(kind), octet(data, 2),
            bits(last, 3, 5))
    elseif number == DATA_TRANSPORT then
        check(RECORD, data)
        local length, came = octet(data, 4), #data - 4
        if length ~= came or length > MAX_RECORD then
            refuse("Data_Transport: octet 4 says %s of data, %d came", octets_text(length), came)
        end
        node_record(nodes, data)
        node_octets(nodes, "data", 4, came)
        text = string.format("%s, data %d", record_title("Data_Transport", data), came)
    elseif request then
        text = record_request(nodes, data)
    else
        text = record_response(nodes, data)
    end
    return nodes, text
end

-- The answer to Request Ident: four lengths, four texts
local ident = {}

do
    local TEXTS = { "vendor_name", "controller_type", "hw_release", "sw_release" }
    local WORDS = { "vendor", "controller", "hardware", "software" }
    local SHORT = { ["\n"] = "\\n", ["\r"] = "\\r", ["\t"] = "\\t" }

    -- latin-1 as dpstack shows it: what a terminal would obey stands as its escape
    local function shown(octets)
        return (string.gsub(octets, "[%z\1-\31\127-\255]", function(letter)
            local code = string.byte(letter)
            if code < 0xA0 or code == 0xAD then
                return SHORT[letter] or string.format("\\x%02x", code)
            end
            return string.char(0xC0 + math.floor(code / 64) % 4, 0x80 + code % 64)
        end))
    end

    -- the texts as { text, place, size }
    local function texts_of(data)
        if #data < 4 then
            refuse("Ident: %d octets; the four lengths alone take 4", #data)
        end
        local at, found, lengths = 4, {}, {}
        for number = 1, 4 do
            local size = octet(data, number)
            lengths[number] = size
            found[number] = { shown(string.sub(data, at + 1, at + size)), at, size }
            at = at + size
        end
        if at > #data then
            refuse("Ident: octets 1 to 4 say lengths %s, and %d octets follow", table.concat(lengths, ", "), #data - 4)
        end
        return found
    end

    function ident.nodes(data)
        local nodes = {}
        for number, one in ipairs(texts_of(data)) do
            if one[3] > 0 then
                node(nodes, TEXTS[number], one[1], one[2], one[3])
            end
        end
        return nodes
    end

    function ident.text(data)
        local parts = {}
        for number, one in ipairs(texts_of(data)) do
            parts[number] = WORDS[number] .. " '" .. one[1] .. "'"
        end
        return table.concat(parts, ", ")
    end

    -- `step`: its place in the course
    function ident.is_answer(telegram, step)
        return not telegram.request and step.service == "Ident" and step.plain
            and telegram.dsap == nil and telegram.ssap == nil
    end

    -- the service of an answer with data that looks like one of Data_Exchange itself
    function ident.service(telegram, step)
        local asked = step.service == "Ident" or step.service == "LSAP_Status"
        if asked and not telegram.request and telegram.data ~= "" and telegram.dsap == nil and telegram.ssap == nil then
            return step.service
        end
        return nil
    end
end

-- PDUs of an S7-200 in PPI telegrams, as dpstack/decode/ppi.py explains them
local ppi = {}

do
    local SERVICE = "PPI"
    local PROTOCOL = 0x32
    local KINDS = { [1] = "request", [2] = "acknowledgement", [3] = "answer", [7] = "user data" }
    local REQUEST, ACKNOWLEDGEMENT, ANSWER, USER_DATA = 1, 2, 3, 7
    local READ, WRITE, RUN, STOP, NEGOTIATE = 0x04, 0x05, 0x28, 0x29, 0xF0
    local FUNCTIONS = {
        [READ] = "read", [WRITE] = "write", [RUN] = "go to RUN", [STOP] = "go to STOP", [NEGOTIATE] = "PDU length",
    }
    local BIT, BYTE, WORD = 1, 2, 4
    local AREAS = {
        [0x84] = { "V", 1 }, [0x83] = { "M", 0 }, [0x81] = { "I", 0 }, [0x82] = { "Q", 0 }, [0x05] = { "SM", 0 },
        [0x04] = { "S", 0 }, [0x06] = { "AI", 0 }, [0x07] = { "AQ", 0 }, [0x1F] = { "T", 0 }, [0x1E] = { "C", 0 },
    }
    -- octets of an element of timers and counters, which begins with a status
    local ELEMENT_LENGTH = { T = 5, C = 3 }
    local SIGNED = { AI = true, AQ = true }
    local SIZES = { [1] = "B", [2] = "W", [4] = "D" }
    local GOOD_CODE = 0xFF
    -- items in the words of one telegram, octets of a value in words
    local SHOWN, MOST_OCTETS = 8, 16
    local SMALLEST, LARGEST = 1e-6, 1e9
    local ITEM_ERRORS = {
        [0x01] = "hardware fault",
        [0x03] = "access is not allowed",
        [0x05] = "the address is beyond this CPU's memory",
        [0x06] = "this area does not have that data type",
        [0x07] = "data type and length do not agree",
        [0x0A] = "there is no such object in this CPU",
    }
    local PDU_ERRORS = {
        [0x8000] = "the function is occupied already",
        [0x8001] = "not allowed in the present mode of the CPU",
        [0x8101] = "hardware fault",
        [0x8103] = "access is not allowed",
        [0x8104] = "the CPU does not have this function, or the request is damaged",
        [0x8105] = "invalid address",
        [0x8106] = "this area does not have that data type",
        [0x8107] = "data type and length do not agree",
        [0x810A] = "there is no such object in this CPU",
        [0x8500] = "the PDU has a wrong length",
        [0xD201] = "wrong name of a block",
        [0xD401] = "wrong requests for information",
    }
    local CLOCK_ORDERS = { [1] = "read the clock", [2] = "set the clock" }
    local MONTH_DAYS = { 31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31 }

    local function hex(octets)
        local found = {}
        for at = 1, #octets do
            found[at] = string.format("%02x", octet(octets, at))
        end
        return table.concat(found, " ")
    end

    -- the number of octets with the most significant one first
    local function number_of(octets)
        local value = 0
        for at = 1, #octets do
            value = value * 256 + octet(octets, at)
        end
        return value
    end

    local function some_of(texts)
        local listed = {}
        for at = 1, math.min(#texts, SHOWN) do
            listed[at] = texts[at]
        end
        return table.concat(listed, ", ") .. (#texts > SHOWN and string.format(" and %d more", #texts - SHOWN) or "")
    end

    local function pdu_error(code)
        return string.format("%s (error %04Xh)", PDU_ERRORS[code] or "unknown error", code)
    end

    local function item_error(code)
        return string.format("%s (code %02Xh)", ITEM_ERRORS[code] or "unknown return code", code)
    end

    -- the PDU of a data unit, nil for other octets; places are octets from 0
    local function parse(data)
        local kind = #data >= 10 and octet(data, 1) == PROTOCOL and octet(data, 2)
        if not KINDS[kind] or word(data, 3) ~= 0 then
            return nil
        end
        local begin = (kind == ACKNOWLEDGEMENT or kind == ANSWER) and 12 or 10
        local parameters, size = word(data, 7), word(data, 9)
        if #data ~= begin + parameters + size then
            return nil
        end
        local pdu = {
            kind = kind, sequence = word(data, 5), error = begin == 12 and word(data, 11) or 0, octets = data,
            parameter = string.sub(data, begin + 1, begin + parameters), parameter_at = begin,
            data = string.sub(data, begin + parameters + 1), data_at = begin + parameters, parts = {},
        }
        return (parameters > 0 or pdu.error ~= 0 or kind == ACKNOWLEDGEMENT) and pdu or nil
    end

    local function items_of(parameter)
        local count = #parameter > 1 and octet(parameter, 2) or 0
        if #parameter ~= math.max(2, 2 + 12 * count) and not (#parameter < 2 and count == 0) then
            refuse("the addresses of the request are damaged")
        end
        local found = {}
        for number = 1, count do
            local own = string.sub(parameter, 12 * number - 9, 12 * number + 2)
            if string.sub(own, 1, 3) ~= "\18\10\16" then
                refuse("the addresses of the request are damaged")
            end
            found[number] = {
                size = octet(own, 4), count = word(own, 5), block = word(own, 7), area = octet(own, 9),
                start = number_of(string.sub(own, 10)), at = 12 * number - 10,
            }
        end
        return found
    end

    local function address_text(item)
        local area = AREAS[item.area]
        local known = item.size == BIT or item.size == BYTE or item.size == WORD or item.size == item.area
        if not area or item.block ~= area[2] or not known then
            return string.format("area 0x%02x, block %d, bit %d, %d of size 0x%02x", item.area, item.block, item.start,
                item.count, item.size)
        end
        local name, many = area[1], item.count ~= 1 and string.format("[%d]", item.count) or ""
        if ELEMENT_LENGTH[name] then
            return string.format("%s%d%s", name, item.start, many)
        end
        local at = math.floor(item.start / 8)
        if item.size == BIT then
            return string.format("%s%d.%d%s", name, at, item.start % 8, many)
        elseif item.size == WORD then
            return string.format("%sW%d%s", name, at, many)
        elseif SIZES[item.count] then
            return string.format("%s%s%d", name, SIZES[item.count], at)
        end
        return string.format("%sB%d%s", name, at, many)
    end

    -- return code and octets of `count` items, with their places in the data
    local function parts_of(data, count)
        local found, at = {}, 0
        for number = 1, count do
            if #data < at + 4 then
                refuse("the data end before item %d of %d", number, count)
            end
            local code, kind, length = octet(data, at + 1), octet(data, at + 2), word(data, at + 3)
            local size = 0
            if code == 0 or code == GOOD_CODE then
                if kind == 3 or kind == 4 then
                    size = math.floor((length + 7) / 8)
                elseif kind == 0 or kind == 9 then
                    size = length
                else
                    refuse("data of unknown kind %02Xh in the answer", kind)
                end
            end
            found[number] = { code = code, octets = string.sub(data, at + 5, at + 4 + size), at = at + 4 }
            at = at + 4 + size + size % 2
        end
        return found
    end

    -- the numbers in the octets of an item, as far as it says how to read them; true or false for a bit
    local function values_of(item, octets)
        if not item or #octets == 0 then
            return {}
        elseif item.size == BIT then
            return { octet(octets, 1) % 2 == 1 }
        end
        local name = AREAS[item.area] and AREAS[item.area][1]
        local element = ELEMENT_LENGTH[name or ""]
        if element then
            local found = {}
            for at = 1, #octets, element do
                found[#found + 1] = number_of(string.sub(octets, at + 1, at + element - 1))
            end
            return found
        elseif not SIZES[#octets] then
            return {}
        end
        local value = number_of(octets)
        if SIGNED[name or ""] and octet(octets, 1) >= 128 then
            value = value - 256 ^ #octets
        end
        return { math.floor(value) }
    end

    -- four octets may be a real
    local function as_real(octets)
        if #octets ~= 4 then
            return ""
        end
        local real = Struct.unpack(">f", octets)
        local size = math.abs(real)
        return size >= SMALLEST and size <= LARGEST and string.format(" (real %g)", real) or ""
    end

    local function value_words(octets, values)
        if type(values[1]) == "boolean" then
            return values[1] and "on" or "off"
        elseif #values > 0 then
            local found = {}
            for at, value in ipairs(values) do
                found[at] = string.format("%.0f", value)
            end
            return table.concat(found, ", ") .. (#values == 1 and as_real(octets) or "")
        end
        local shown = hex(string.sub(octets, 1, MOST_OCTETS))
        if #octets > MOST_OCTETS then
            return string.format("%s ... (%d)", shown, #octets)
        end
        return shown ~= "" and shown or "nothing"
    end

    -- the nodes of item `number`; `at`: place of an octet of it
    local function item_group(nodes, item, number, at)
        local label = item and address_text(item) or string.format("item %d", number)
        local one = group(nodes, "Item " .. number .. ": " .. label, at, 1)
        if item then
            node(one, "items.address", label, at)
        end
        return one, label
    end

    local function valued(nodes, pdu, items, count, codes)
        local texts = {}
        for number, part in ipairs(parts_of(pdu.data, count)) do
            local item, at = items[number], pdu.data_at + part.at
            local one, label = item_group(nodes, item, number, at - 4)
            if codes and part.code ~= GOOD_CODE then
                node(one, "items.error", item_error(part.code), at - 4)
                texts[number] = string.format("%s refused: %s", label, item_error(part.code))
            else
                local values = values_of(item, part.octets)
                node_octets(one, "items.octets", at, #part.octets)
                for _, value in ipairs(values) do
                    node(one, "items.value", value == true and 1 or value or 0, at, #part.octets)
                end
                texts[number] = label .. " = " .. value_words(part.octets, values)
                if item then
                    pdu.parts[#pdu.parts + 1] = { item = item, octets = part.octets, at = at }
                end
            end
        end
        return some_of(texts)
    end

    -- the items of the request, if there are as many as the answer says, and that number
    local function asked_items(asked, func, pdu)
        local count = #pdu.parameter > 1 and octet(pdu.parameter, 2) or 0
        if asked and octet(asked.parameter, 1) == func then
            local items = items_of(asked.parameter)
            if #items == count then
                return items, count
            end
        end
        return {}, count
    end

    local function length_text(nodes, pdu, ending)
        if #pdu.parameter ~= 8 then
            refuse("a parameter of %d octets, not 8", #pdu.parameter)
        end
        local length = word(pdu.parameter, 7)
        node(nodes, "pdu_length", length, pdu.parameter_at + 6, 2)
        return string.format("PDUs of up to %d octets%s", length, ending)
    end

    local function mode_text(nodes, pdu, asked)
        local wanted = octet(asked and asked.parameter ~= "" and asked.parameter or pdu.parameter, 1)
        return (FUNCTIONS[wanted] or "") .. (pdu.kind == REQUEST and "" or ": done")
    end

    local ASKED = {
        [READ] = function(nodes, pdu)
            local texts = {}
            for number, item in ipairs(items_of(pdu.parameter)) do
                local _, label = item_group(nodes, item, number, pdu.parameter_at + item.at)
                texts[number] = label
            end
            return "read " .. some_of(texts)
        end,
        [WRITE] = function(nodes, pdu)
            local items = items_of(pdu.parameter)
            return "write " .. valued(nodes, pdu, items, #items, false)
        end,
        [RUN] = mode_text,
        [STOP] = mode_text,
        [NEGOTIATE] = function(nodes, pdu) return length_text(nodes, pdu, "?") end,
    }
    local ANSWERED = {
        [READ] = function(nodes, pdu, asked)
            local items, count = asked_items(asked, READ, pdu)
            return valued(nodes, pdu, items, count, true)
        end,
        [WRITE] = function(nodes, pdu, asked)
            local items, count = asked_items(asked, WRITE, pdu)
            if count ~= #pdu.data then
                refuse("%d return codes for %d items", #pdu.data, count)
            end
            local texts = {}
            for number = 1, count do
                local code, at = octet(pdu.data, number), pdu.data_at + number - 1
                local one, label = item_group(nodes, items[number], number, at)
                if code == GOOD_CODE then
                    node(one, "items.done", true, at)
                    texts[number] = label .. " written"
                else
                    node(one, "items.error", item_error(code), at)
                    texts[number] = string.format("%s refused: %s", label, item_error(code))
                end
            end
            return some_of(texts)
        end,
        [RUN] = mode_text,
        [STOP] = mode_text,
        [NEGOTIATE] = function(nodes, pdu) return length_text(nodes, pdu, "") end,
    }

    -- the time of the CPU's clock in words; the reason where it is none
    local function clock_words(octets)
        local numbers = {}
        for at = 1, 10 do
            local value = octet(octets, at)
            numbers[at] = 10 * math.floor(value / 16) + value % 16
        end
        local year = numbers[3] + (numbers[3] >= 90 and 1900 or 2000)
        local month, day, hour, minute, second = numbers[4], numbers[5], numbers[6], numbers[7], numbers[8]
        local thousandths = numbers[9] * 10 + math.floor(octet(octets, 10) / 16)
        local leap = year % 4 == 0 and (year % 100 ~= 0 or year % 400 == 0)
        local days = (MONTH_DAYS[month] or 0) + (month == 2 and leap and 1 or 0)
        if day < 1 or day > days or hour > 23 or minute > 59 or second > 59 or thousandths > 999 then
            return nil, "no time of a clock: " .. hex(octets)
        end
        return string.format("%04d-%02d-%02d %02d:%02d:%02d.%03d", year, month, day, hour, minute, second, thousandths)
    end

    local function user_data_text(pdu, request)
        local order = #pdu.parameter >= 7 and octet(pdu.parameter, 6) % 16 == 7 and octet(pdu.parameter, 7)
        local text = CLOCK_ORDERS[order]
        if not text then
            return string.format("parameter %s, data %s", hex(pdu.parameter), pdu.data ~= "" and hex(pdu.data) or "none")
        end
        local code = number_of(string.sub(pdu.parameter, 11, 12))
        if code ~= 0 then
            return "clock: refused: " .. pdu_error(code)
        elseif #pdu.data >= 14 then
            local time, reason = clock_words(string.sub(pdu.data, 5, 14))
            return time and text .. (request and " to " or ": ") .. time or text .. ": " .. reason
        end
        return text .. (request and "" or ": done")
    end

    -- nodes and words of a PDU; `asked`: the request, of an answer
    local function explain(pdu, asked, request)
        local nodes = {}
        local func = pdu.kind ~= USER_DATA and pdu.parameter ~= "" and octet(pdu.parameter, 1) or nil
        local named = func and (FUNCTIONS[func] or string.format("0x%02x", func))
        node(nodes, "ppi_pdu", KINDS[pdu.kind], 1)
        node(nodes, "sequence", pdu.sequence, 4, 2)
        if named then
            node(nodes, "function", named, pdu.parameter_at)
        end
        if pdu.error ~= 0 then
            node(nodes, "error", pdu_error(pdu.error), 10, 2)
            return nodes, "refused: " .. pdu_error(pdu.error)
        elseif pdu.kind == USER_DATA then
            return nodes, user_data_text(pdu, request)
        end
        local read = (request and ASKED or ANSWERED)[func]
        if not read then
            return nodes, pdu.kind == ACKNOWLEDGEMENT and "done" or "function " .. (named or "unknown")
        end
        local more = {}
        local good, text = pcall(read, more, pdu, asked)
        if good then
            for _, one in ipairs(more) do
                nodes[#nodes + 1] = one
            end
            return nodes, text
        elseif type(text) == "table" then
            return nodes, named .. ", damaged: " .. hex(pdu.octets)
        end
        error(text, 0)
    end

    -- Put what a telegram is for an S7-200 into its step: `ppi` (nodes and text of its PDU), `service`. A station that has
    -- parameters or a configuration of a DP slave is none.
    function ppi.follow(line, telegram, step, is_slave)
        local request = telegram.request
        local cpu, master = telegram.da, telegram.sa
        if not request then
            cpu, master = master, cpu
        end
        local plain = telegram.kind ~= "SC" and telegram.kind ~= "SD4" and telegram.dsap == nil and telegram.ssap == nil
        if not plain then
            if is_slave then
                line.slaves[cpu] = true
            end
            return
        end
        local pair = cpu * 128 + master
        if telegram.data == "" then
            if request and line.pdus[pair] and ppi.EXCHANGES[telegram.func] then
                step.service = SERVICE
            end
            return
        end
        local pdu = not line.slaves[cpu] and parse(telegram.data)
        if not pdu then
            return
        end
        local asked = line.pdus[pair]
        if request then
            line.pdus[pair], asked = pdu, nil
        elseif asked and asked.sequence ~= pdu.sequence then
            asked = nil
        end
        local nodes, text = explain(pdu, asked, request)
        if text ~= "" then
            node(nodes, "text", text, 0, #telegram.data)
        end
        step.ppi, step.service = { nodes = nodes, text = text, parts = pdu.parts }, SERVICE
    end

    -- SRD low and high, and MSRD
    ppi.EXCHANGES = set(12, 13, 7)

    -- the first octet of a value in those of an item, and its bit if it is one; nil if the item does not hold all of it
    function ppi.place(item, value)
        if value.area ~= item.area or value.block ~= item.block then
            return nil
        end
        local away = value.start - item.start
        if item.size == BIT or item.size == item.area then
            if value.transport ~= item.size or away < 0 or away >= item.count then
                return nil
            end
            return away * value.length, item.size == BIT and 0 or nil
        end
        local at, bit_number = math.floor(away / 8), away % 8
        local octets = item.count * (item.size == WORD and 2 or 1)
        if at < 0 or at + value.length > octets or (bit_number > 0 and value.transport ~= BIT) then
            return nil
        end
        return at, value.transport == BIT and bit_number or nil
    end

    -- the service of a telegram that looks like Data_Exchange itself
    function ppi.service(telegram, step)
        local is_ppi = step.service == SERVICE and telegram.kind ~= "SC"
        return is_ppi and (telegram.request or telegram.data ~= "") and SERVICE or nil
    end
end

local REQUEST_UNITS = { [61] = set_prm, [62] = configuration, [58] = global_control, [55] = set_slave_add }
local ANSWER_UNITS = { [60] = slave_diag, [59] = configuration }

-- slave's and master's SAP of a telegram
local function saps(telegram)
    if telegram.request then
        return telegram.dsap, telegram.ssap
    end
    return telegram.ssap, telegram.dsap
end

local function is_dpv1(slave, master)
    return slave == 50 or slave == 51 or (slave <= 49 and master == 50)
end

-- The nodes of a telegram's data unit, and the reason where it cannot be read.
local function data_unit(telegram, step)
    local slave, master = saps(telegram)
    if telegram.data == "" then
        return {}
    elseif step.ppi then
        return step.ppi.nodes
    end
    local read
    if slave ~= nil then
        read = (telegram.request and REQUEST_UNITS or ANSWER_UNITS)[slave]
    elseif master == nil and clock.is_value(telegram) then
        read = clock.nodes
    elseif ident.is_answer(telegram, step) then
        read = ident.nodes
    end
    if not read and (slave == nil or not is_dpv1(slave, master)) then
        return {}
    end
    local good, found = pcall(read or dpv1, telegram.data, telegram.request)
    if good then
        return found
    elseif type(found) == "table" then
        return {}, found.pdu
    end
    error(found, 0)
end

-- --- a telegram in words, as dpstack/decode/words.py has it ----------------------------------------------------------

local function contents(telegram, step)
    local slave, master = saps(telegram)
    if step.ppi then
        return step.ppi.text
    end
    if telegram.data ~= "" and ident.is_answer(telegram, step) then
        return ident.text(telegram.data)
    end
    if slave == nil and master == nil and clock.is_value(telegram) and #telegram.data == 18 then
        return clock.text(telegram.data)
    elseif slave == nil or telegram.data == "" then
        return ""
    elseif slave == 61 and telegram.request then
        return checks.text(telegram.data)
    elseif slave == 60 then
        local messages, texts = {}, {}
        if not telegram.request and #telegram.data >= 6 and #telegram.data <= 244 then
            for _, block in ipairs((split_blocks(string.sub(telegram.data, 7)))) do
                local message = block.kind == 0 and message_of(block.octets)
                if message then
                    local number = message.is_status and "" or ", sequence number " .. message.sequence
                    messages[#messages + 1] = message.text .. number
                else
                    texts[#texts + 1] = block_text(block)
                end
            end
        end
        return table.concat(#messages > 0 and messages or texts, "; ")
    elseif is_dpv1(slave, master) then
        local good, found, text = pcall(dpv1, telegram.data, telegram.request)
        if good then
            return text
        elseif type(found) == "table" then
            return ""
        end
        error(found, 0)
    end
    return ""
end

local function control_text(data)
    local control, groups = octet(data, 1), octet(data, 2)
    local words = { bit(control, 1) and "Clear" or "Operate" }
    for number, name in pairs({ [2] = "Unfreeze", [3] = "Freeze", [4] = "Unsync", [5] = "Sync" }) do
        if bit(control, number) then
            words[#words + 1] = { number, name }
        end
    end
    local sorted = {}
    for at = 2, #words do
        sorted[at - 1] = words[at]
    end
    table.sort(sorted, function(one, other) return one[1] < other[1] end)
    local parts = { words[1] }
    for _, one in ipairs(sorted) do
        parts[#parts + 1] = one[2]
    end
    local reserved = control - bits(control, 1, 5) * 2
    if reserved > 0 then
        parts[#parts + 1] = string.format("reserved bits 0x%02x", reserved)
    end
    local members = {}
    for number = 0, 7 do
        if bit(groups, number) then
            members[#members + 1] = number + 1
        end
    end
    return table.concat(parts, " ") .. ", "
        .. (#members > 0 and "group " .. table.concat(members, ", ") or "all groups")
end

local function function_text(telegram)
    if not telegram.request then
        return (RESPONSES[telegram.func] or "status " .. telegram.func) .. ", " .. STATION_TYPES[bits(telegram.fc, 4, 2)]
    end
    local parts = {}
    if SHORT_NAMES[telegram.func] then
        parts[1] = SHORT_NAMES[telegram.func]
    elseif not BY_FUNCTION[telegram.func] then
        parts[1] = "function " .. telegram.func
    end
    local fcv, fcb = bit(telegram.fc, 4), bit(telegram.fc, 5)
    if fcv or fcb or COUNTED[telegram.func] then
        parts[#parts + 1] = string.format("FCV=%d FCB=%d", fcv and 1 or 0, fcb and 1 or 0)
    end
    return #parts > 0 and table.concat(parts, ", ") or string.format("FC 0x%02x", telegram.fc)
end

-- `step`: its place in the course; `unit_error`: why its data unit cannot be read
local function describe(telegram, step, unit_error)
    local name = ppi.service(telegram, step) or ident.service(telegram, step) or service_of(telegram)
    if telegram.kind == "SC" then
        if step.service == nil then
            return "SC"
        end
        return string.format("SC %d -> %d, acknowledges %s", step.pair[2], step.pair[1], step.service)
    end
    local way = telegram.sa .. " -> " .. (telegram.da == BROADCAST and "all" or telegram.da)
    if telegram.kind == "SD4" then
        return "token " .. way .. (telegram.sa == telegram.da and " (to itself)" or "")
    end
    local side = "answer "
    if telegram.request then
        side = UNANSWERED[telegram.func] and "" or "request "
    elseif name == "acknowledgement" then
        side = ""
    end
    local front = name .. " " .. side .. way
    local size = #telegram.data
    if name == "Global_Control" and telegram.request and size == 2 then
        front = front .. ", " .. control_text(telegram.data)
    elseif size > 0 then
        local words = unit_error and "cannot be read (" .. unit_error .. ")" or contents(telegram, step)
        front = front .. ", " .. octets_text(size) .. (words ~= "" and ": " .. words or "")
    end
    if telegram.kind == "SD2" and size == 0 and not (telegram.dsap or telegram.ssap or telegram.dseg or telegram.sseg) then
        front = front .. ", LE = 3"
    end
    if telegram.dseg then
        front = front .. ", DSEG " .. telegram.dseg
    end
    if telegram.sseg then
        front = front .. ", SSEG " .. telegram.sseg
    end
    return front .. " (" .. function_text(telegram) .. ")"
end

-- --- the course of the bus, as dpstack/decode/course.py follows it ---------------------------------------------------

-- by port: asked (the request whose answer is due), missed (the one before it, that nobody answered in time), last (by
-- master and station), holder of the token, passer (of the token, as long as its holder has sent nothing), damages
-- (damaged transmissions so far), latest (the last request, if it is to have an answer), slaves (stations that are DP
-- slaves), pdus (the last PDU that a CPU was sent, by CPU and master)
local lines = {}
-- by number of the packet: what it is in the course
local steps = {}
-- by number of a request: the number of its answer; the number of the telegram that ended the wait for one
local answers, given_up = {}, {}
local NOTHING = {}

local function follow_damaged(line, octets)
    line.damages = line.damages + 1
    line.missed, line.holder, line.passer = nil, nil, nil
    local at = ({ [SD1] = 2, [SD2] = 5 })[string.byte(octets, 1) or 0]
    local da, sa, fc
    if at and #octets >= at + 2 then
        da, sa, fc = octet(octets, at) % 128, octet(octets, at + 1) % 128, octet(octets, at + 2)
    end
    local step = { damaged = true, remarks = {} }
    local asked = line.asked
    if fc and bit(fc, 6) then
        step.remarks[1] = string.format("probably a request %d -> %d", sa, da)
    elseif asked then
        asked.damaged = true
        local readable = fc and da == asked.telegram.sa and sa == asked.telegram.da
        step.probably_answers = asked.number
        step.remarks[1] = string.format("probably the answer to telegram %d%s", asked.number,
            readable and ", as its addresses say" or "")
    end
    return step
end

local function without_token(line, sa)
    local holder = line.holder
    line.holder, line.passer = sa, nil
    if holder == nil or holder == sa then
        return {}
    end
    return { string.format("station %d sends without the token, which station %d holds", sa, holder) }
end

local function give_up(line, number)
    local asked = line.asked
    line.asked = nil
    if asked == nil then
        return nil
    end
    line.missed = asked
    if asked.damaged then
        return nil
    end
    given_up[asked.number] = number
    return asked.number
end

local function follow_token(line, telegram, number)
    local sa, da, holder = telegram.sa, telegram.da, line.holder
    local remarks = {}
    if holder ~= nil and holder ~= sa then
        if line.passer == sa then
            local again = da == holder and "the token again" or "the token to another station"
            remarks[1] = string.format("%s: station %d did not take it", again, holder)
        elseif sa == da then
            remarks[1] = string.format("station %d claims the token, which station %d held", sa, holder)
        else
            remarks = without_token(line, sa)
        end
    end
    line.holder, line.passer = da, sa ~= da and sa or nil
    return { unanswered = give_up(line, number), remarks = remarks, token = true }
end

local function same_telegram(one, other)
    for _, key in ipairs({ "kind", "da", "sa", "fc", "dsap", "ssap", "data", "dseg", "sseg" }) do
        if one[key] ~= other[key] then
            return false
        end
    end
    return true
end

local function follow_request(line, telegram, number)
    local remarks = without_token(line, telegram.sa)
    local step = {
        unanswered = give_up(line, number), remarks = remarks, pair = { telegram.sa, telegram.da },
        poll = telegram.func == FDL_STATUS,
    }
    line.latest = nil
    if telegram.da == BROADCAST or UNANSWERED[telegram.func] then
        return step
    end
    local request = { telegram = telegram, number = number, answered = false, damages = line.damages, step = step }
    line.asked, line.latest = request, request
    if not COUNTED[telegram.func] then
        return step
    end
    local pair = telegram.sa * 128 + telegram.da
    local before = line.last[pair]
    line.last[pair] = request
    if before == nil then
        return step
    end
    local same = not before.answered and same_telegram(telegram, before.telegram)
    if not bit(telegram.fc, 4) then
        step.repeated_poll_of = same and before.number or nil
        return step
    end
    local turned = bit(telegram.fc, 5) ~= bit(before.telegram.fc, 5)
    if same and not turned then
        step.retry_of = before.number
    elseif before.damages ~= line.damages then
        return step -- a request or an answer between them may be missing
    elseif before.answered and not turned then
        remarks[#remarks + 1] = string.format(
            "the frame count bit was not turned: station %d takes this for a repetition", telegram.da)
    elseif not before.answered then
        remarks[#remarks + 1] = string.format(
            "another request with %s frame count bit, though the one before was not answered",
            turned and "a turned" or "the same")
    end
    step.fcb_turned = turned
    return step
end

local function fits(telegram, request)
    local to = telegram.da == BROADCAST and request.func == 7 and BROADCAST or request.sa
    return telegram.kind == "SC" or (telegram.sa == request.da and telegram.da == to)
end

local function answer_step(line, request, number)
    local asked = request.telegram
    local service = line.latest == request and request.step.service or service_of(asked)
    answers[request.number] = answers[request.number] or number
    return {
        answer_to = request.number, service = service, from = asked.da, remarks = {},
        plain = asked.dsap == nil and asked.ssap == nil,
        pair = { asked.sa, asked.da }, poll = asked.func == FDL_STATUS,
    }
end

local function follow_answer(line, telegram, number)
    local asked, missed = line.asked, line.missed
    if asked and fits(telegram, asked.telegram) then
        line.asked, line.missed = nil, nil
        asked.answered = true
        return answer_step(line, asked, number)
    elseif missed and fits(telegram, missed.telegram) then
        line.missed = nil
        local step = answer_step(line, missed, number)
        step.late = true
        step.remarks = {
            string.format("an answer to telegram %d, when nobody waited for it any more", missed.number),
        }
        return step
    end
    if line.holder == nil and line.damages == 0 then
        return { remarks = {} } -- the capture begins between a request and its answer
    end
    return { remarks = { "an answer that no request before it asked for" } }
end

-- whether the telegram shows that the station asked or answering is a DP slave: its parameters, configuration, diagnosis
local function is_of_slave(telegram, step)
    local slave = saps(telegram)
    local shows = telegram.request and (slave == 61 or slave == 62) or not telegram.request and (slave == 59 or slave == 60)
    if telegram.kind == "SC" or not shows or telegram.data == "" then
        return false
    end
    local _, unit_error = data_unit(telegram, step)
    return unit_error == nil
end

local function follow(port, telegram, octets, number)
    local line = lines[port]
    if line == nil then
        line = { last = {}, damages = 0, slaves = {}, pdus = {} }
        lines[port] = line
    end
    if telegram == nil then
        return follow_damaged(line, octets)
    elseif telegram.kind == "SD4" then
        return follow_token(line, telegram, number)
    end
    local step = (telegram.request and follow_request or follow_answer)(line, telegram, number)
    ppi.follow(line, telegram, step, is_of_slave(telegram, step))
    return step
end

-- Put the time from the end of its request into the step of an answer, as soon as times and the rate are known.
local function time_answer(step, baud)
    local request = step.answer_to and steps[step.answer_to]
    if request and not step.response_ns and step.begun and request.begun and baud > 0 then
        local duration = math.floor((request.size * 11 * 1000000000 + math.floor(baud / 2)) / baud)
        step.response_ns = step.begun - request.begun - duration
    end
end

-- --- fields ----------------------------------------------------------------------------------------------------------

local yes_no = { "yes", "no" }
local fields = {}
local register = {}

local function define(key, make)
    fields[key] = make
    register[#register + 1] = make
end

local function abbreviation(key)
    return "profibus." .. key
end

local function text_field(key, name)
    define(key, ProtoField.string(abbreviation(key), name))
end

local function number_field(key, name, most)
    define(key, ProtoField[most and "uint" .. most or "uint8"](abbreviation(key), name, base.DEC))
end

local function hex_field(key, name, most)
    define(key, ProtoField["uint" .. (most or 8)](abbreviation(key), name, base.HEX))
end

local function yes_no_field(key, name)
    define(key, ProtoField.bool(abbreviation(key), name, base.NONE, yes_no))
end

local function octets_field(key, name)
    define(key, ProtoField.bytes(abbreviation(key), name, base.SPACE))
end

text_field("kind", "Kind of telegram")
number_field("da", "Destination address (DA)")
number_field("sa", "Source address (SA)")
number_field("from", "From the station asked")
hex_field("fc", "Function code (FC)")
text_field("function", "Function")
text_field("station_type", "Station type")
yes_no_field("fcb", "Frame count bit (FCB)")
yes_no_field("fcv", "Frame count bit valid (FCV)")
number_field("le", "Length (LE)")
number_field("dsap", "Destination SAP (DSAP)")
number_field("ssap", "Source SAP (SSAP)")
number_field("dseg", "Destination segment (DSEG)")
number_field("sseg", "Source segment (SSEG)")
hex_field("fcs", "Check sequence (FCS)")
text_field("service", "Service")
octets_field("data", "Data unit")
octets_field("octets", "Octets")
text_field("error", "Error")
text_field("damage", "Marked by the port")
text_field("text", "In words")
text_field("pair", "Master and station")
text_field("station", "Station")
text_field("value", "Value")
define("retry_of", ProtoField.framenum("profibus.retry_of", "Retry of", base.NONE, frametype.RETRANS_PREV))
define("response_in", ProtoField.framenum("profibus.response_in", "Answered in", base.NONE, frametype.RESPONSE))
define("response_to", ProtoField.framenum("profibus.response_to", "Answer to", base.NONE, frametype.REQUEST))
define("unanswered", ProtoField.framenum("profibus.unanswered", "Not answered before this", base.NONE, frametype.REQUEST))
define("given_up_in", ProtoField.framenum("profibus.given_up_in", "Not answered until", base.NONE))
define("response_time", ProtoField.relative_time("profibus.response_time", "Response time"))
yes_no_field("late", "Late answer")
define("repeated_poll_of", ProtoField.framenum("profibus.repeated_poll_of", "The same poll as", base.NONE))
define("probably_answers", ProtoField.framenum("profibus.probably_answers", "Probably the answer to", base.NONE))
yes_no_field("fcb_turned", "FCB was turned")
text_field("remark", "Out of order")

-- of a data unit: the names of the standard
for _, name in ipairs({
    "Lock_Req", "Unlock_Req", "Sync_Req", "Freeze_Req", "WD_On", "DPV1_Enable", "Fail_Safe", "Publisher_Enable", "WD_Base_1ms",
    "Check_Cfg_Mode", "Prm_Structure", "PrmCmd", "IsoM_Req", "Cfg_Data.consistent", "Clear_Data", "Unfreeze", "Freeze", "Unsync",
    "Sync", "No_Add_Chg", "Add_Ack", "Ext_Diag_Data.if_dpv1.Add_Ack", "ANH", "SWT", "SYF",
}) do
    yes_no_field("dp." .. string.lower(name), name)
end
for _, name in ipairs({
    "WD_Fact_1", "WD_Fact_2", "min_T_SDR", "Group_Ident", "Blocks.type", "Blocks.slot", "Blocks.specifier",
    "Cfg_Data.inputs", "Cfg_Data.outputs", "Group_Select", "New_Slave_Add", "Master_Add", "Ext_Diag_Data.module",
    "Ext_Diag_Data.channel", "Ext_Diag_Data.error", "Ext_Diag_Data.revision", "Ext_Diag_Data.if_dpv1.Alarm_Type",
    "Ext_Diag_Data.if_dpv1.Status_Type", "Ext_Diag_Data.if_dpv1.Slot_Number", "Ext_Diag_Data.if_dpv1.Alarm_Specifier",
    "Ext_Diag_Data.if_dpv1.Status_Specifier", "Ext_Diag_Data.if_dpv1.Seq_Nr", "Subnet", "Instance", "Reason_Code",
    "Server_SAP", "Slot_Number", "Alarm_Type", "Alarm_Specifier", "Seq_Nr", "Index", "Length", "Max_Len_Data_Unit",
    "S_Addr.API", "S_Addr.SCL", "D_Addr.API", "D_Addr.SCL",
}) do
    number_field("dp." .. string.lower(name), name)
end
number_field("dp.watchdog_ms", "Watchdog time in ms", 32)
for _, name in ipairs({
    "function", "properties", "output_hold_time", "version", "t_base_dp", "t_dp", "t_mapc", "t_base_io", "t_i", "t_o", "t_dx",
    "t_pll_w", "t_pll_d", "clock_sync_interval", "cs_delay_seconds", "cs_delay_fraction",
}) do
    number_field("dp.blocks.content." .. name, "Blocks.content." .. name, 32)
end
number_field("dp.cr_ms", "CR_ms", 16)
number_field("dp.sequence", "Sequence", 16)
number_field("dp.pdu_length", "PDU_Length", 16)
define("dp.items.value", ProtoField.double("profibus.dp.items.value", "Items.value"))
yes_no_field("dp.items.done", "Items.done")
octets_field("dp.items.octets", "Items.octets")
define("dp.cv", ProtoField.int8("profibus.dp.cv", "CV", base.DEC))
number_field("dp.ext_diag_data.modules", "Ext_Diag_Data.modules", 16)
for _, name in ipairs({
    "Ident_Number", "Features_Supported", "Profile_Features_Supported", "Profile_Ident_Number",
}) do
    hex_field("dp." .. string.lower(name), name, 16)
end
for _, name in ipairs({ "Function_Num", "Error_Decode", "Error_Code_1", "Error_Code_2", "reserved" }) do
    hex_field("dp." .. string.lower(name), name)
end
for _, name in ipairs({
    "Alarms", "Alarm_Mode", "Blocks.links", "Blocks.text", "demands", "findings", "flags", "finding", "Ext_Diag_Data.kind", "Ext_Diag_Data.text",
    "Ext_Diag_Data.characters", "Ext_Diag_Data.if_dpv1.text", "function", "text", "alarm", "Clock_Value_Time_Event",
    "Clock_Value_previous_TE", "PPI_PDU", "error", "Items.address", "Items.error", "Vendor_Name", "Controller_Type", "HW_Release", "SW_Release",
}) do
    text_field("dp." .. string.lower(name), name)
end
for _, name in ipairs({
    "User_Prm_Data", "Blocks.data", "Cfg_Data.identifier", "Cfg_Data.manufacturer", "Rem_Slave_Data", "rest",
    "Ext_Diag_Data.data", "Ext_Diag_Data.if_dpv1.data", "data", "S_Addr.net", "D_Addr.net",
}) do
    octets_field("dp." .. string.lower(name), name)
end
define("dp.send_timeout_s", ProtoField.double("profibus.dp.send_timeout_s", "Send time-out in s"))
profibus.fields = register

local experts = {
    retry = ProtoExpert.new("profibus.expert.retry", "Retry", expert.group.SEQUENCE, expert.severity.NOTE),
    lost = ProtoExpert.new("profibus.expert.lost", "Not answered", expert.group.SEQUENCE, expert.severity.WARN),
    late = ProtoExpert.new("profibus.expert.late", "Late answer", expert.group.SEQUENCE, expert.severity.WARN),
    remark = ProtoExpert.new("profibus.expert.remark", "Out of order", expert.group.SEQUENCE, expert.severity.WARN),
    damaged = ProtoExpert.new("profibus.expert.damaged", "Damaged", expert.group.CHECKSUM, expert.severity.ERROR),
    unreadable = ProtoExpert.new("profibus.expert.unreadable", "Data unit that cannot be read", expert.group.MALFORMED,
        expert.severity.WARN),
    refused = ProtoExpert.new("profibus.expert.refused", "Refused", expert.group.RESPONSE_CODE, expert.severity.NOTE),
    gap = ProtoExpert.new("profibus.expert.gap", "Octets are missing before this", expert.group.SEQUENCE,
        expert.severity.WARN),
}
profibus.experts = {
    experts.retry, experts.lost, experts.late, experts.remark, experts.damaged, experts.unreadable, experts.refused,
    experts.gap,
}

-- --- what the file says of a packet ----------------------------------------------------------------------------------

local function extractor(name)
    local good, found = pcall(Field.new, name)
    return good and found or function() end
end

local frame_port = extractor("frame.interface_name")
local frame_about = extractor("frame.interface_description")
local frame_comment = extractor("frame.comment")
-- error bits of epb_flags, in the order of dpstack; true: the octets themselves do not show it
local MARKS = {
    { extractor("frame.packet_flags_crc_error"), "check sequence" },
    { extractor("frame.packet_flags_packet_too_error"), "too long", true },
    { extractor("frame.packet_flags_packet_too_short_error"), "too short" },
    { extractor("frame.packet_flags_start_frame_delimiter_error"), "start octet" },
    { extractor("frame.packet_flags_symbol_error"), "parity or framing", true },
}

-- Time of the first bit in ns since the first packet, nil where the file has none. (As a number, the time since 1970
-- would not be exact to the nanosecond.)
local function time_of_frame(pinfo)
    if pinfo.abs_ts == 0 then
        return nil
    end
    return math.floor(pinfo.rel_ts * 1000000000 + 0.5)
end

local UNITS = { [""] = 1, k = 1000, M = 1000000 }
-- by description of an interface
local rates = {}

-- the baud rate that the description of an interface names ("/dev/ttyUSB0, 500 kbit/s, 8 data bits, even parity")
local function baud_of_frame()
    if profibus.prefs.baud > 0 then
        return profibus.prefs.baud
    end
    local info = frame_about()
    local about = info and tostring(info.value) or ""
    if rates[about] == nil then
        rates[about] = 0
        for number, unit, more in string.gmatch(about, "(%d+%.?%d*) ([kM]?)bit/s(%C?)") do
            rates[about] = math.floor(tonumber(number) * UNITS[unit] + 0.5)
            if more == "," then -- ", 8 data bits", as dpstack writes it
                break
            end
        end
    end
    return rates[about]
end

-- UTF-8: controls, marks without width, signs that turn the direction of a text
local NEVER = {
    "%c", "\194[\128-\159]", "\226\128[\139-\143\168-\174]", "\226\129[\160-\175]", "\216\156", "\239\187\191",
    "\243\160[\128-\131][\128-\191]",
}

-- a text of the file without what a terminal would obey: tshark prints columns as they are
local function printable(text)
    for _, pattern in ipairs(NEVER) do
        text = string.gsub(text, pattern, "?")
    end
    return text
end

-- the names of all marks, and of those that the octets themselves do not show
local function marks_of_frame()
    local all, unseen = {}, {}
    for _, mark in ipairs(MARKS) do
        local info = mark[1]()
        if info and info.value then
            all[#all + 1] = mark[2]
            unseen[#unseen + 1] = mark[3] and mark[2] or nil
        end
    end
    return all, unseen
end

-- --- the names of the plant ----------------------------------------------------------------------------------------

-- by address: name, inputs and outputs; of the file that was read
local names = { path = "" }

local function cells_of(line)
    local cells = {}
    for cell in string.gmatch(line .. "\t", "([^\t]*)\t") do
        cells[#cells + 1] = cell
    end
    return cells
end

local function read_names(path)
    names = { path = path }
    local file = path ~= "" and io.open(path, "r")
    if not file then
        names.error = path ~= "" and "Names of the plant: " .. path .. " cannot be read" or nil
        return
    end
    if not string.find(file:read("*l") or "", "^# names for the PROFIBUS dissector of dpstack") then
        names.error = "Names of the plant: " .. path .. " is no file of `dpstack wireshark names`"
        file:close()
        return
    end
    for line in file:lines() do
        local cells = cells_of(line)
        local address = tonumber(cells[1])
        if address and (cells[2] == "station" or #cells >= 12) then
            names[address] = names[address] or { input = {}, output = {}, memory = {} }
            if cells[2] == "station" then
                names[address].name = printable(cells[3] or "")
            elseif names[address][cells[2]] then
                local known = names[address][cells[2]]
                known[#known + 1] = {
                    kind = cells[3], octet = tonumber(cells[4]) or 0, size = tonumber(cells[5]) or 0,
                    bit = tonumber(cells[6]) or 0, width = tonumber(cells[7]) or 0, order = cells[8],
                    scale = tonumber(cells[9]) or 1, offset = tonumber(cells[10]) or 0,
                    unit = printable(cells[11]), name = printable(cells[12]),
                    -- of a value in the memory of an S7-200
                    area = tonumber(cells[13]), block = tonumber(cells[14]), start = tonumber(cells[15]),
                    transport = tonumber(cells[16]), length = tonumber(cells[17]),
                }
            end
        end
    end
    file:close()
end

local function names_of(address)
    if names.path ~= profibus.prefs.names then
        read_names(profibus.prefs.names)
    end
    return address and names[address]
end

-- the value of a named field in words, nil if the octets are too short
local function value_text(field, data)
    local own = string.sub(data, field.octet + 1, field.octet + field.size)
    if #own < field.size or field.size == 0 then
        return nil
    end
    if field.kind == "bool" then
        return bit(string.byte(own), field.bit) and "yes" or "no"
    elseif field.kind == "bytes" then
        return (string.gsub(own, ".", function(one) return string.format("%02X ", string.byte(one)) end))
    end
    if field.order == "little" then
        own = string.reverse(own)
    elseif field.order == "swapped" then
        own = string.sub(own, 3) .. string.sub(own, 1, 2)
    end
    local value = 0
    if field.kind == "float" then
        value = Struct.unpack(#own == 8 and ">d" or ">f", own)
    else
        for at = 1, #own do
            value = value * 256 + string.byte(own, at)
        end
        value = math.floor(value / 2 ^ field.bit) % 2 ^ field.width
        if field.kind == "int" and value >= 2 ^ (field.width - 1) then
            value = value - 2 ^ field.width
        end
    end
    value = value * field.scale + field.offset
    return string.format("%.9g", value) .. (field.unit ~= "" and " " .. field.unit or "")
end

-- the named values in the items of a PDU: of those read or written, with their octets
function ppi.add_values(tree, tvb, telegram, parts, known)
    for _, part in ipairs(parts) do
        for _, field in ipairs(known) do
            local begin, first_bit = ppi.place(part.item, field)
            local own = begin and string.sub(part.octets, begin + 1, begin + field.length) or ""
            if begin and #own == field.length then
                field.bit = first_bit or field.bit
                local text = value_text(field, own)
                if text then
                    tree:add(fields.value, tvb(telegram.data_at + part.at + begin, #own), field.name .. " = " .. text)
                end
            end
        end
    end
end

-- the named values of a Data_Exchange: outputs of the station asked, or inputs of the one that answers
local function add_values(tree, tvb, telegram, step)
    local known = names_of(telegram.request and telegram.da or telegram.sa)
    if not known or telegram.dsap or telegram.ssap then
        return
    elseif step.ppi then
        ppi.add_values(tree, tvb, telegram, step.ppi.parts, known.memory)
        return
    end
    for _, field in ipairs(known[telegram.request and "output" or "input"]) do
        local text = value_text(field, telegram.data)
        if text then
            tree:add(fields.value, tvb(telegram.data_at + field.octet, field.size), field.name .. " = " .. text)
        end
    end
end

-- an address for people: with the name of its station
local function station(address)
    local known = names_of(address)
    return tostring(address) .. (known and known.name and " " .. known.name or "")
end

-- --- the tree --------------------------------------------------------------------------------------------------------

local function add_nodes(tree, tvb, start, nodes)
    for _, one in ipairs(nodes) do
        local range = tvb(start + one.at, one.size)
        if one.title then
            add_nodes(tree:add(range, one.title), tvb, start, one)
        elseif one.value == nil then
            tree:add(fields["dp." .. one.key], range)
        else
            tree:add(fields["dp." .. one.key], range, one.value)
        end
    end
end

local function add_link_layer(tree, tvb, telegram)
    tree:add(fields.kind, tvb(0, 1), telegram.kind)
    if telegram.kind == "SC" then
        return
    end
    if telegram.kind == "SD2" then
        tree:add(fields.le, tvb(1, 1))
    end
    tree:add(fields.da, tvb(telegram.da_at, 1), telegram.da)
    tree:add(fields.sa, tvb(telegram.da_at + 1, 1), telegram.sa)
    if telegram.kind == "SD4" then
        return
    end
    local range = tvb(telegram.da_at + 2, 1)
    local fc = tree:add(fields.fc, range)
    local names = telegram.request and REQUESTS or RESPONSES
    local named = clock.is_value(telegram) and "CLOCK_VALUE" or names[telegram.func]
    fc:add(fields["function"], range, named or "reserved " .. telegram.func)
    fc:append_text(" (" .. function_text(telegram) .. ")")
    if telegram.request then
        fc:add(fields.fcb, range, bit(telegram.fc, 5))
        fc:add(fields.fcv, range, bit(telegram.fc, 4))
    else
        fc:add(fields.station_type, range, STATION_TYPES[bits(telegram.fc, 4, 2)])
    end
    for _, key in ipairs({ "dsap", "dseg", "ssap", "sseg" }) do
        if telegram[key] then
            local item = tree:add(fields[key], tvb(telegram[key .. "_at"], 1), telegram[key])
            local name = key ~= "dseg" and key ~= "sseg" and BY_SAP[telegram[key]]
            if name and (key == "dsap") == telegram.request then
                item:append_text(" (" .. name .. ")")
            end
        end
    end
    tree:add(fields.fcs, tvb(telegram.end_at, 1)):append_text(" (right)")
end

local function add_course(tree, step, number)
    if step.pair then
        tree:add(fields.pair, step.pair[1] .. "-" .. step.pair[2]):set_generated()
    end
    if answers[number] then
        tree:add(fields.response_in, answers[number]):set_generated()
    elseif given_up[number] then
        tree:add(fields.given_up_in, given_up[number]):set_generated()
    end
    for _, key in ipairs({ "retry_of", "repeated_poll_of", "unanswered", "probably_answers", "late" }) do
        if step[key] then
            tree:add(fields[key], step[key]):set_generated()
        end
    end
    if step.fcb_turned ~= nil then
        tree:add(fields.fcb_turned, step.fcb_turned):set_generated()
    end
    if step.answer_to then
        tree:add(fields.response_to, step.answer_to):set_generated()
    end
    if step.response_ns then
        local ns = step.response_ns
        local seconds = math.floor(math.abs(ns) / 1000000000) * (ns < 0 and -1 or 1)
        tree:add(fields.response_time, NSTime.new(seconds, ns - seconds * 1000000000)):set_generated()
    end
    for _, remark in ipairs(step.remarks) do
        tree:add(fields.remark, remark):set_generated()
    end
end

-- Expert infos: what a reader should look at.
local function findings(telegram, flaw, unit_error, step, number, told, comments)
    local found = {}
    local function tell(kind, text)
        found[#found + 1] = { experts[kind], text }
    end
    if flaw then
        tell("damaged", flaw)
    elseif told then
        tell("damaged", told)
    end
    if unit_error then
        tell("unreadable", unit_error)
    end
    if telegram and not telegram.request and telegram.fc and not GOOD[telegram.func] then
        tell("refused", "Answered " .. (RESPONSES[telegram.func] or "by a reserved status"))
    end
    if step.retry_of then
        tell("retry", "Retry of telegram " .. step.retry_of)
    elseif step.unanswered and not (steps[step.unanswered] or NOTHING).poll then
        tell("lost", "Telegram " .. step.unanswered .. " was not answered")
    end
    if given_up[number] and not answers[number] and not step.poll then
        tell("lost", "Nobody answered")
    end
    if not step.damaged then
        for _, remark in ipairs(step.remarks) do
            tell(step.late and "late" or "remark", remark)
        end
    end
    for _, comment in ipairs(comments) do
        if string.find(comment, "lost") or string.find(comment, "gap") then
            tell("gap", comment)
        end
    end
    return found
end

-- whether somebody looks at the fields of this packet: a tree on the screen, a filter, a tap
local function is_looked_at(tree)
    return tree.visible or tree:referenced(Dissector.get("profibus"))
end

-- the line that `dpstack decode` prints
local function words(telegram, flaw, unit_error, step, notes)
    local parts = { telegram and describe(telegram, step, unit_error) or flaw }
    if step.retry_of then
        parts[2] = "retry of " .. step.retry_of
    elseif step.repeated_poll_of then
        parts[2] = "the same poll as " .. step.repeated_poll_of
    elseif step.unanswered then
        parts[2] = step.unanswered .. " was not answered"
    end
    for _, list in ipairs({ step.remarks, notes }) do
        for _, text in ipairs(list) do
            parts[#parts + 1] = text
        end
    end
    return table.concat(parts, "; ")
end

function profibus.dissector(tvb, pinfo, tree)
    local size = tvb:reported_length_remaining()
    local octets = tvb:captured_len() > 0 and tvb:raw() or ""
    local number = pinfo.number
    local telegram, flaw = decode(octets)
    local step = steps[number]
    if step == nil then
        local port = frame_port()
        step = follow(port and tostring(port.value) or "", telegram, octets, number)
        step.begun, step.size = time_of_frame(pinfo), #octets
        steps[number] = step
    end
    time_answer(step, baud_of_frame())
    local nodes, unit_error = NOTHING, nil
    if telegram then
        nodes, unit_error = data_unit(telegram, step)
    end

    local marks, unseen = marks_of_frame()
    local notes, comments = {}, {}
    local told = telegram and marks or unseen
    if #told > 0 then
        told = "marked by the port: " .. table.concat(told, ", ")
        notes[1] = told
    else
        told = nil
    end
    for at, comment in ipairs({ frame_comment() }) do
        comments[at] = printable(tostring(comment.value))
        notes[#notes + 1] = comments[at]
    end

    local text = words(telegram, flaw, unit_error, step, notes)
    pinfo.cols.protocol = "PROFIBUS"
    pinfo.cols.info = text
    if telegram and telegram.sa then
        pinfo.cols.src = station(telegram.sa)
        pinfo.cols.dst = telegram.da == BROADCAST and "all" or station(telegram.da)
    elseif step.pair then
        pinfo.cols.src = station(step.pair[2])
        pinfo.cols.dst = station(step.pair[1])
    end

    local all = size > 0 and tvb() or nil
    local found = findings(telegram, flaw, unit_error, step, number, told, comments)
    local known, looked_at = pcall(is_looked_at, tree)
    if known and not looked_at and #found == 0 then
        return size
    end
    local root = all and tree:add(profibus, all, "PROFIBUS: " .. text) or tree:add(profibus, "PROFIBUS: " .. text)
    for _, one in ipairs(found) do
        root:add_proto_expert_info(one[1], one[2])
    end
    root:add(fields.text, text):set_generated()
    for _, address in ipairs(telegram and { telegram.sa, telegram.da } or NOTHING) do
        local known = names_of(address)
        if known and known.name then
            root:add(fields.station, known.name):set_generated()
        end
    end
    if names.error then
        root:add(profibus, names.error)
    end
    if telegram then
        add_link_layer(root:add(all, "Link layer (FDL)"), tvb, telegram)
        local service = service_of(telegram)
        if step.service and (telegram.kind == "SC" or (telegram.dsap == nil and telegram.ssap == nil)) then
            service = step.service
        end
        root:add(fields.service, service):set_generated()
        if telegram.kind == "SC" and step.from then
            root:add(fields.from, step.from):set_generated()
        end
        if telegram.data ~= "" then
            local range = tvb(telegram.data_at, #telegram.data)
            local unit = root:add(range, service .. ", data unit")
            unit:add(fields.data, range)
            add_nodes(unit, tvb, telegram.data_at, nodes)
            add_values(unit, tvb, telegram, step)
            if unit_error then
                unit:add(fields.error, range, unit_error)
            end
        end
    else
        if all then
            root:add(fields.octets, all)
        end
        root:add(fields.error, flaw)
    end
    for _, mark in ipairs(marks) do
        root:add(fields.damage, mark)
    end
    add_course(root:add(profibus, "Course of the bus"), step, number)
    return size
end

function profibus.init()
    lines, steps, answers, given_up, rates = {}, {}, {}, {}, {}
end

-- link type 147 and no other one
DissectorTable.get("wtap_encap"):add((wtap_encaps or wtap).USER0, profibus)

-- --- the table by master and slave -----------------------------------------------------------------------------------

local COLUMNS = { "requests", "answers", "retries", "no answer", "late", "min us", "mean us", "max us" }

local function new_table()
    return { rows = {}, telegrams = 0, tokens = 0, damaged = 0, unasked = 0, polls = 0, polled = 0 }
end

local function row_of(counts, pair)
    local key = pair[1] * 128 + pair[2]
    if counts.rows[key] == nil then
        counts.rows[key] = { pair = pair, requests = 0, answers = 0, retries = 0, lost = 0, late = 0, sum = 0, timed = 0 }
    end
    return counts.rows[key]
end

local function count(counts, number)
    local step = steps[number]
    if step == nil then
        return
    end
    counts.telegrams = counts.telegrams + 1
    if step.damaged then
        counts.damaged = counts.damaged + 1
    elseif step.token then
        counts.tokens = counts.tokens + 1
    elseif step.poll then
        counts.polls = counts.polls + (step.answer_to and 0 or 1)
        counts.polled = counts.polled + (step.answer_to and 1 or 0)
    elseif step.pair and not step.answer_to then
        local row = row_of(counts, step.pair)
        row.requests = row.requests + 1
        row.retries = row.retries + (step.retry_of and 1 or 0)
    elseif step.pair then
        local row = row_of(counts, step.pair)
        row.answers = row.answers + (step.late and 0 or 1)
        row.late = row.late + (step.late and 1 or 0)
        if step.response_ns and not step.late then
            local us = step.response_ns / 1000
            row.sum, row.timed = row.sum + us, row.timed + 1
            row.min, row.max = math.min(row.min or us, us), math.max(row.max or us, us)
        end
    else
        counts.unasked = counts.unasked + 1
    end
    local missed = step.unanswered and steps[step.unanswered]
    if missed and missed.pair and not missed.poll then
        local row = row_of(counts, missed.pair)
        row.lost = row.lost + 1
    end
end

local function table_text(counts)
    local keys, out = {}, {}
    for key in pairs(counts.rows) do
        keys[#keys + 1] = key
    end
    table.sort(keys)
    out[1] = "PROFIBUS by master and slave"
    out[2] = string.format("%6s %5s" .. string.rep(" %9s", #COLUMNS), "master", "slave", table.unpack(COLUMNS))
    for _, key in ipairs(keys) do
        local row = counts.rows[key]
        local times = { "-", "-", "-" }
        -- an answer before the end of its request: no wire gave the octets their time
        if row.timed > 0 and row.min >= 0 then
            times = {
                string.format("%.1f", row.min), string.format("%.1f", row.sum / row.timed), string.format("%.1f", row.max),
            }
        end
        local slave = row.pair[2] == BROADCAST and "all" or tostring(row.pair[2])
        out[#out + 1] = string.format("%6d %5s %9d %9d %9d %9d %9d %9s %9s %9s", row.pair[1], slave, row.requests,
            row.answers, row.retries, row.lost, row.late, times[1], times[2], times[3])
    end
    out[#out + 1] = string.format("%d telegrams, %d of them tokens, %d damaged, %d answers without a request",
        counts.telegrams, counts.tokens, counts.damaged, counts.unasked)
    out[#out + 1] = string.format("%d requests FDL_Status (GAP), %d of them answered", counts.polls, counts.polled)
    return table.concat(out, "\n")
end

local function tap(show)
    local counts = new_table()
    local listener = Listener.new("frame")
    function listener.packet(pinfo)
        count(counts, pinfo.number)
    end
    function listener.draw()
        show(table_text(counts))
    end
    function listener.reset()
        counts = new_table()
    end
    return listener
end

if gui_enabled() then
    register_menu("PROFIBUS/Table by master and slave", function()
        local window = TextWindow.new("PROFIBUS by master and slave")
        local listener = tap(function(text) window:set(text) end)
        window:set_atclose(function() listener:remove() end)
        retap_packets()
    end, MENU_TOOLS_UNSORTED)
else
    local listening = nil
    function profibus.prefs_changed()
        if profibus.prefs.table and not listening then
            listening = tap(function(text) io.stdout:write(text, "\n") end)
        elseif listening and not profibus.prefs.table then
            listening:remove()
            listening = nil
        end
    end
end

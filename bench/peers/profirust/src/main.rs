//! profirust as a master of `python -m bench peers`: `profirust-peer PORT SLAVES SLEEP_US`, at 500 kbit/s, slaves from
//! address 3 on with 12 octets each way, polled as the examples of profirust do, with SLEEP_US between two polls.
//! One JSON line says when all slaves are in data exchange; the end of standard input ends the program.

use profirust::{dp, fdl, phy, time, Baudrate};
use std::io::Read;

const OWN: u8 = 2;
const FIRST: u8 = 3;
const OCTETS: usize = 12;

fn main() {
    let words: Vec<String> = std::env::args().collect();
    let [_, port, slaves, sleep_us] = &words[..] else {
        panic!("usage: profirust-peer PORT SLAVES SLEEP_US");
    };
    let last = FIRST + slaves.parse::<u8>().unwrap() - 1;
    let sleep = std::time::Duration::from_micros(sleep_us.parse().unwrap());
    std::thread::spawn(|| {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        std::process::exit(0);
    });

    let mut master = dp::DpMaster::new(vec![]);
    for address in FIRST..=last {
        let options = dp::PeripheralOptions {
            ident_number: 0x0696,
            user_parameters: Some(&[]), // with None it waits for them
            config: Some(&[0xF3, 0x71]),
            max_tsdr: 100,
            ..Default::default()
        };
        master.add(dp::Peripheral::new(
            address,
            options,
            vec![0; OCTETS],
            vec![0; OCTETS],
        ));
    }
    let mut station = fdl::FdlActiveStation::new(
        fdl::ParametersBuilder::new(OWN, Baudrate::B500000)
            .slot_bits(4000) // its table for adapters: 8 ms with a sleep of 3.5 ms
            .highest_station_address(OWN + 1) // no GAP to poll
            .token_rotation_bits(1_000_000) // the token never ends a round
            .max_retry_limit(3)
            .watchdog_timeout(time::Duration::from_secs(2))
            .build_verified(&master),
    );
    let mut line = phy::SerialPortPhy::new(port.as_str(), Baudrate::B500000);
    station.set_online();
    master.enter_operate();
    let mut ready = false;
    loop {
        station.poll(time::Instant::now(), &mut line, &mut master);
        if master.take_last_events().cycle_completed {
            for (_, slave) in master.iter_mut() {
                let (inputs, outputs) = slave.pi_both();
                outputs.copy_from_slice(inputs);
            }
            if !ready && master.iter().all(|(_, slave)| slave.is_running()) {
                ready = true;
                println!("{{\"ready\": 1}}");
            }
        }
        if !sleep.is_zero() {
            std::thread::sleep(sleep);
        }
    }
}
